"""Correlations of the fitted parameters: which pairs a response knows only together."""

import numpy as np

from orbitfb.loco.estimates import contrast
from orbitfb.loco.measured import bpm_labels, corrector_labels
from orbitfb.loco.run import Result
from orbitfb.loco.schema import Correlation
from orbitfb.physics.places import Plane

_STRONG = 0.5
"""Correlation from which a pair is told [1]: a quarter of the variance of one is that of the
other."""

_MOST = 500
"""Pairs that are told; of neighbouring quadrupoles there are hundreds."""


def correlations(result: Result) -> tuple[Correlation, ...]:
    """Give the strongest pairs, in the gauge that the values are told in.

    Args:
        result: Of the fit.
    """
    fit = result.fit
    planes: dict[str, Plane] = {plane: plane for plane in result.mended.planes}
    usual = {
        plane: fit.groups.of[f"gain:{plane}"][~result.estimates[f"gain:{plane}"].free]
        for plane in planes
    }
    forms: list[np.ndarray] = []
    names: list[str] = []
    for name in fit.groups.of:
        kind, _, plane = name.partition(":")
        if name not in result.estimates:
            continue
        if kind == "gradient":
            own = result.ring.names("QUAD")
        elif kind in ("gain", "row-phase"):
            own = bpm_labels(result.mended, result.ring, planes[plane])
        else:
            own = corrector_labels(result.mended, result.ring, planes[plane])
        forms.append(contrast(fit, name, usual)[0])
        names += [f"{kind} {its}" for its in own]
    form = np.vstack(forms)
    covariance = form @ fit.posterior.covariance @ form.T
    sigma = np.sqrt(np.diag(covariance))
    rho = np.triu(covariance / np.outer(sigma, sigma), 1)
    first, second = np.nonzero(np.abs(rho) >= _STRONG)
    order = np.argsort(-np.abs(rho[first, second]))[:_MOST]
    return tuple(
        Correlation(first=names[i], second=names[j], correlation=float(rho[i, j]))
        for i, j in zip(first[order], second[order], strict=True)
    )
