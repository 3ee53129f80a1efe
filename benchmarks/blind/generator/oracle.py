"""How well an effect can be seen at all: the same actions with and without it, filtered.

The difference of the two readings, through the Kalman filter of a random walk of the true steps
under the true reading noise, mode by mode, has the squared length d'² = 2 ΔL: what somebody who
knows the effect exactly, but of the small errors of its devices only how they scatter, gains by it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Law
from benchmarks.blind.generator.machine import Log, Nature, run
from benchmarks.blind.generator.rings import Array


class Innovations:
    """The filter of a case."""

    def __init__(self, case: Conditions) -> None:
        self.noise = case.noise
        walk = np.zeros((len(case.noise),) * 2)
        for plane in case.all_planes:
            kicks = np.diff(case.quad_kicks[plane], axis=0)
            part = case.bpm_columns(plane)
            orbit = kicks @ case.lattice.response(case.bpms, case.lattice.quads, plane).T
            walk[part, part] = orbit.T @ orbit / len(orbit)
        scaled = walk / np.outer(self.noise, self.noise)
        power, self.modes = np.linalg.eigh(scaled)
        self.power = np.maximum(power, 1e-6)

    def whiten(self, difference: Array) -> Array:
        """Turn a difference of readings (rows, n) [m] into whitened innovations."""
        modes = difference / self.noise @ self.modes
        state = np.zeros(modes.shape[1])
        white = np.empty_like(modes)
        shares, totals = self.gains(len(modes))
        for row, seen in enumerate(modes):
            white[row] = (seen - state) / np.sqrt(totals[row])
            state = state + shares[row] * (seen - state)
        return white

    def gains(self, rows: int) -> tuple[Array, Array]:
        """Give the gain of every row and mode and the variance of its innovation, (rows, n)."""
        doubt = np.full(len(self.power), 1e8)
        shares, totals = np.empty((rows, len(doubt))), np.empty((rows, len(doubt)))
        for row in range(rows):
            totals[row] = doubt + 1.0
            shares[row] = doubt / totals[row]
            doubt = doubt * (1 - shares[row]) + self.power
        return shares, totals


@dataclass(frozen=True)
class Small:
    """Small errors that nobody knows, beside which an effect on the mean is seen.

    Args:
        errors: One standard deviation each.
        leave: Tells what is seen of a whitened change beside more of them.
    """

    errors: Sequence[Nature] = ()
    leave: Callable[[Array, Log], float] | None = None


def detectability(
    case: Conditions,
    log: Log,
    seed: int,
    law: Law,
    filter_: Innovations,
    rows: slice,
    small: Small,
) -> float:
    """Tell d' of a single effect on some rows of its run.

    Args:
        case: Circumstances.
        log: Of the run with the effect.
        seed: Of the run.
        law: How the effect shows.
        filter_: Of the case; it knows nothing of the orbit before the first row.
        rows: Of the record that count.
        small: Beside which it is seen.
    """
    without = run(case, [], seed, replay=_extend(case, log.sent)).readings[rows]
    log = _cut(log, rows)
    rows = slice(rows.start, rows.start + len(log.readings))
    change = log.readings - without[: len(log.readings)]
    white = filter_.whiten(change)
    if law == "mean" and small.leave is not None:
        return small.leave(white, log)
    if law == "mean":
        return _beside(white, [changed(case, log, e, seed, filter_, rows) for e in small.errors])
    if law == "rare":  # whole ticks
        struck = np.any(change != 0, axis=1)
        return _mixture(np.sum(white**2, axis=1), float(struck.mean()))
    if law == "spikes":  # single readings: seen against the noise of each, next to nothing else
        alone = (change / filter_.noise) ** 2
        columns = alone.any(axis=0)
        return _mixture(alone[:, columns].ravel(), float((alone[:, columns] > 0).mean()))
    power = np.maximum(np.linalg.eigvalsh(white.T @ white / len(white)), 0)
    return float(np.sqrt(len(white) * np.sum(power - np.log1p(power))))


def changed(
    case: Conditions,
    log: Log,
    error: Nature,
    seed: int,
    filter_: Innovations,
    rows: slice = slice(0, None),
) -> Array:
    """Whitened change of some readings of a run by a further error, (rows, n)."""
    sent = _extend(case, log.sent)
    there, plain = (run(case, its, seed, replay=sent).readings for its in ([(0, error)], []))
    return filter_.whiten((there - plain)[rows])


def _cut(log: Log, rows: slice) -> Log:
    """Some rows of the record of a run."""
    return replace(
        log,
        readings=log.readings[rows],
        setpoints=log.setpoints[rows],
        actions=log.actions[rows],
    )


def _beside(white: Array, healthy: Sequence[Array]) -> float:
    """d' of a change when the sizes of others, normal with variance 1, are open."""
    total = float(np.sum(white**2))
    if not healthy:
        return float(np.sqrt(total))
    rows = min(len(white), *map(len, healthy))
    others = np.stack([its[:rows].ravel() for its in healthy])
    pull = others @ white[:rows].ravel()
    known = others @ others.T + np.eye(len(others))
    return float(np.sqrt(max(total - pull @ np.linalg.solve(known, pull), 0.0)))


def _mixture(power: Array, share: float) -> float:
    """d' of strikes that nobody knows: each is found only if it is rarer by itself than strikes."""
    if share == 0:
        return 0.0
    gain = np.logaddexp(np.log1p(-share), np.log(share) + power / 2)
    return float(np.sqrt(2 * max(np.sum(gain), 0.0)))


def _extend(case: Conditions, sent: Array) -> Array:
    """Setpoints of every row, the last ones held on where a run was stopped early."""
    return np.vstack([sent, np.tile(sent[-1], (case.rows - len(sent), 1))])
