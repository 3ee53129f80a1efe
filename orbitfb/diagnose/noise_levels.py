"""Another level of all the reading noise, or of all the ground motion, from some row on."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.healthy_levels import BETWEEN, WITHIN
from orbitfb.diagnose.randomness import EDGE, LEVELS, beyond_healthy
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix

_AS_GOOD = 5.0
"""Gains that differ by less say nothing of which level it is [nats]."""
_LOG_FACTORS = (-3.0, 5.0)
"""Range of the logarithm of a variance's factor."""


def level_candidates(bench: Bench, kinds: Sequence[EffectKind]) -> list[Candidate]:
    """Try another level of all the reading noise, or of all the walk, from some row on.

    What a level explains best decides between them; how far it is from healthy ones only says how
    sure it is.

    Args:
        bench: The record under the causes accepted so far.
        kinds: Those that the record can show.
    """
    levels = [kind for kind in kinds if isinstance(kind, NoiseKind) and kind.id in LEVELS]
    found = [one for kind in levels if (one := _level(bench, kind)) is not None]
    best = max((gain for gain, _ in found), default=0.0)
    return [candidate for gain, candidate in found if gain > best - _AS_GOOD]


def _level(bench: Bench, kind: NoiseKind) -> tuple[float, Candidate] | None:
    """Another level of one noise: its gain, and the candidate that it makes.

    The variance of a mode's innovation goes with q as its share L / (2 − L), and with r² as the
    rest. Without a reference the level of the whole record is what the floor was fitted to; a
    change within it is judged against the record's own other part.
    """
    record = bench.record
    share = bench.floor.gains / (2.0 - bench.floor.gains)
    share = share if kind.colour == "walk" else 1.0 - share
    squares = bench.white**2
    factors = np.exp(np.linspace(*_LOG_FACTORS, 41))
    by_row = np.empty((len(factors), len(squares)))
    for index, factor in enumerate(factors):
        more = (factor - 1.0) * share
        by_row[index] = -0.5 * np.sum(np.log1p(more)) + 0.5 * squares @ (more / (1.0 + more))
    by_row[:, record.starts] = 0.0
    before = np.cumsum(by_row, axis=1)
    whole = before[:, -1]
    if bench.told_floor:
        row, choices = 0, 1.0
        gain, ratio = float(np.max(whole)), _best_factor(squares[~record.starts], share)
    else:
        after = whole[:, None] - before
        steps = before.max(axis=0) + after.max(axis=0) - float(whole.max())
        steps[:EDGE] = 0.0
        steps[-EDGE:] = 0.0
        row = int(np.argmax(steps))
        if not row:
            return None
        gain, choices = float(steps[row]), float(len(steps))
        counted = ~record.starts
        late, early = (
            _best_factor(squares[part][counted[part]], share)
            for part in (slice(row + 1, None), slice(0, row + 1))
        )
        ratio = late / early
    scatter = BETWEEN if bench.told_floor else WITHIN
    beyond = np.array([gain - np.log(choices)])
    sure = float(beyond_healthy(beyond, np.array([ratio]), scatter)[0])
    places: tuple[int, ...] = () if kind.target == "ring" else tuple(range(len(record.layout.bpms)))
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = float(np.sqrt(ratio))
    cause = Cause(kind, places, values, row + 1 if row else 0)
    return (gain, Candidate(cause, sure, 1.0, "all", gain)) if sure > 0 else None


def _best_factor(squares: Matrix, share: Vector) -> float:
    """Factor of a variance that has a share of every mode's innovations, at its likeliest."""
    mean = np.mean(squares, axis=0)

    def cost(log_factor: float) -> float:
        more = np.expm1(log_factor) * share
        return float(np.sum(np.log1p(more) - mean * more / (1.0 + more)))

    found: Any = minimize_scalar(cost, bounds=_LOG_FACTORS, method="bounded")
    return float(np.exp(found.x))
