"""Whether a cause is what its law says at all times and frequencies: a loose cable is not."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import FreeCourse, evidence_of_sizes
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import EventLaw, RandomLaw
from orbitfb.estimation.priors import VALUE_COST
from orbitfb.estimation.transform import Matrix

_WINDOWS = (6, 18, 54)
"""Windows of a record in each of which a cause may have a size of its own. By hand: a factor of
three apart; what changes more often averages out in each."""
_LEAST_ROWS = 20
"""Least rows of a window. By hand: two seconds at 10 Hz."""
_ORBITS = 16
"""Orbits whose courses stand for what a cause adds: those of the largest singular values. By hand:
correctors of a cell make six."""


def varying(accepted: Sequence[Candidate], space: Workspace) -> list[FreeCourse]:
    """Weigh whether causes have other sizes in some windows or bands than in others.

    Args:
        accepted: Causes.
        space: With them.

    Returns:
        For every cause that adds something known, and every length of windows; and for every one
        that is random, of its spectrum.
    """
    if not accepted:
        return []
    found, weighed = list[FreeCourse](), Weighed.of(space)
    for one in accepted:
        if one.walk is not None or one.white is not None:
            found += _by_band(one, weighed)
        made = _made(one, space)
        if made is None:
            continue
        several = [count for count in _WINDOWS if len(made) >= count * _LEAST_ROWS]
        cost = VALUE_COST + float(np.log(max(len(several), 1)))
        left, sizes, right = np.linalg.svd(made - made.mean(axis=0), full_matrices=False)
        courses, patterns = (left * sizes)[:, :_ORBITS], right[:_ORBITS]
        for count in several:
            spectra = [space.transform.quick_spectrum(part) for part in _windows(courses, count)]
            pull, information = weighed.columns(
                [pattern[:, None] for pattern in patterns], np.hstack(spectra)
            )
            worth = float(evidence_of_sizes(pull[None], information[None])[0].item())
            found.append(FreeCourse("varying", one.names, worth - cost, cost=cost))
    return found


def _by_band(one: Candidate, weighed: Weighed) -> Iterator[FreeCourse]:
    """Weigh whether a random cause has the spectrum of its law.

    What its pattern sees has the mean square ρ = 1 in every band; another one is likelier by
    w (ρ − 1 − ln ρ) / 2 of w frequencies, less what a level of any size costs there.
    """
    space = weighed.space
    for law in space.courses.laws(one.kind):
        if not isinstance(law, RandomLaw) or law.relative or law.lag:
            continue
        transform, count = space.transform, space.transform.count
        pattern = law.patterns[:, one.places[0] if one.places else 0]
        square = (weighed.pulled @ pattern) ** 2
        usual = weighed.weights @ ((pattern @ space.noise.modes) ** 2)
        told = np.stack([square, usual], axis=1)
        ratio = np.divide(*transform.by_band(told).T)
        worth = 0.5 * np.sum(count * (ratio - 1.0 - np.log(ratio)) - np.log1p(0.5 * count))
        yield FreeCourse("spectrum", one.names, float(worth) - VALUE_COST, cost=VALUE_COST)


def _windows(courses: Matrix, count: int) -> Iterator[Matrix]:
    """Courses of which nothing is left but in one window, window by window, shape (N, k) each."""
    edges = np.linspace(0, len(courses), count + 1).astype(int)
    for begin, end in pairwise(edges):
        part = np.zeros_like(courses)
        part[begin:end] = courses[begin:end]
        yield part


def _made(one: Candidate, space: Workspace) -> Matrix | None:
    """What a cause adds to the readings, shape (N, n) [m]; None: that is random.

    The course of what strikes at random was told of the record, and is never the same.
    """
    laws = space.courses.laws(one.kind)
    if one.courseless or any(isinstance(law, EventLaw | RandomLaw) for law in laws):
        return None
    field = one.field
    if one.columns:
        sizes = np.zeros(len(space.terms))
        sizes[list(one.columns)] = space.priors.mean(space.errors.pull)[list(one.columns)]
        own = space.terms.contribution(sizes)
        field = own if field is None else field + own
    return None if field is None else space.transform.summed(field)
