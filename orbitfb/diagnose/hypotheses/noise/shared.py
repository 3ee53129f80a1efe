"""Whether BPMs have noise in common: a test of every two, whoever they are."""

import numpy as np

from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.priors import VALUE_COST

_ALIKE = 5.0
"""Standard deviations from which a BPM is told beside the two that have most in common. By hand:
of 360 BPMs one is told by chance in one record of 2,400."""


def shared_noise(space: Workspace) -> FreeCourse:
    """Weigh the noise that two BPMs have in common, or have of opposite sign.

    The derivative of the log likelihood by the covariance v_ij of the readings' noise is
    s_ij = Σ_f λ_f (p_i p_j − Ω_ij) with p = Ω z, of variance Σ_f λ_f² (Ω_ii Ω_jj + Ω_ij²): a score
    test (C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948) 50). Its square over twice the variance is
    what a covariance of the best size is worth.

    Args:
        space: With all causes.

    Returns:
        Of the two that have most, with the others that have noise in common with one of them.
    """
    transform, noise = space.transform, space.noise
    eigenvalue = transform.eigenvalue
    pulled = noise.pull(space.left, transform)
    inverse = 1.0 / noise.variance(transform)
    expected = (noise.modes * (eigenvalue @ inverse)) @ noise.modes.T
    scatter = np.zeros_like(expected)
    for band in range(len(transform.count)):
        rows = transform.members(band)
        precision = (noise.modes * inverse[rows].mean(axis=0)) @ noise.modes.T
        own = np.diag(precision)
        scatter += np.sum(eigenvalue[rows] ** 2) * (np.outer(own, own) + precision**2)
    score = ((pulled * eigenvalue[:, None]).T @ pulled - expected) / np.sqrt(scatter)
    np.fill_diagonal(score, 0.0)
    size = np.abs(score)
    two = np.unravel_index(int(np.argmax(size)), size.shape)
    pairs = max(len(size) * (len(size) - 1) / 2.0, 1.0)
    cost = float(np.log(pairs)) + VALUE_COST
    beside = size[:, list(two)].max(axis=1)
    alike = [place for place in np.argsort(-beside) if place in two or beside[place] > _ALIKE]
    bpms = space.signals.record.layout.bpms
    names = tuple(bpms.label(int(place)) for place in alike)
    return FreeCourse("shared", names, 0.5 * float(size[two]) ** 2 - cost, cost=cost)
