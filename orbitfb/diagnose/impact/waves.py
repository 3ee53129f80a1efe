"""A wave of the orbit as kicks at places: what a simulated ring is given to have the same wave.

A line is found with whatever shape the ground may give it, so its orbit need not be that of the one
place that leads. Kicks at further places are taken in, the one that lowers the rest most each time
(orthogonal matching pursuit: Y. Pati, R. Rezaiifar, P. Krishnaprasad, Asilomar 1993), weighed by
what the floor leaves uncertain at its frequency.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import DeviceLaw, Values
from orbitfb.estimation.priors import MOST_DEVICES
from orbitfb.estimation.transform import Matrix

_LEFT = 0.01
"""Share of a wave's energy that may be left [1]: a tenth of its amplitude."""


@dataclass(frozen=True, slots=True, eq=False)
class Wave:
    """Kicks of one frequency at places.

    Args:
        places: Numbers of the places, the strongest first.
        names: Of them.
        values: Of the parameters, by place.
        field: Spectrum of what they add to the readings, shape (T, n) [m].
    """

    places: tuple[int, ...]
    names: tuple[str, ...]
    values: tuple[Values, ...]
    field: Matrix


def wave_of(part: Candidate, space: Workspace) -> Wave | None:
    """Make kicks of a wave; None of a candidate that is none.

    Args:
        part: The candidate, at its leading place.
        space: Of the record.
    """
    if part.field is None or part.sources:
        return None
    for law in space.courses.laws(part.kind):
        if isinstance(law, DeviceLaw) and law.periodic:
            return _kicks(part, law, space)
    return None


def _kicks(part: Candidate, law: DeviceLaw, space: Workspace) -> Wave:
    cosine, sine = (parameter.name for parameter in part.kind.parameters[:2])
    none = {**part.values, cosine: 0.0, sine: 0.0}
    units = [law.course({**none, name: 1.0}, space.signals)[0][:, :1] for name in (cosine, sine)]
    waves = space.transform.spectrum(np.hstack(units))
    wanted = np.linalg.lstsq(waves, np.asarray(part.field), rcond=None)[0].T
    weight = _weight(waves, space)
    patterns = np.asarray(sum(law.patterns[1:], law.patterns[0]))
    target, seen = weight @ wanted, weight @ patterns
    chosen, sizes = _pursued(target, seen, part.places[0])
    order = np.argsort(-np.hypot(*sizes.T))
    chosen, sizes = [chosen[place] for place in order], sizes[order]
    field = waves @ (patterns[:, chosen] @ sizes).T
    told = tuple({**part.values, cosine: float(own[0]), sine: float(own[1])} for own in sizes)
    return Wave(tuple(chosen), tuple(law.names[place] for place in chosen), told, field)


def _weight(waves: Matrix, space: Workspace) -> Matrix:
    """Square root of the precision of the orbit at the wave's frequency, shape (n, n) [1/m]."""
    power = np.sum(waves**2, axis=1)
    level = float(np.sum(power * space.transform.eigenvalue) / np.sum(power))
    noise = space.noise
    return (noise.modes / np.sqrt(noise.variance_at(np.array([level]))[0])).T


def _pursued(target: Matrix, seen: Matrix, first: int) -> tuple[list[int], Matrix]:
    """Places, and the two amplitudes of each, shape (k, 2)."""
    norm: Vector = np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    chosen = [first]
    whole = float(np.sum(target**2))
    while True:
        sizes = np.asarray(np.linalg.lstsq(seen[:, chosen], target, rcond=None)[0], np.float64)
        rest = target - seen[:, chosen] @ sizes
        if np.sum(rest**2) < _LEFT * whole or len(chosen) == MOST_DEVICES:
            return chosen, sizes
        gain = np.sum((seen.T @ rest) ** 2, axis=1) / norm**2
        gain[chosen] = -1.0
        chosen.append(int(np.argmax(gain)))
