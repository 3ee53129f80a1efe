"""How well an effect can be seen at all: the same actions with and without it, filtered.

The difference of the two readings, through the Kalman filter of ground that moves by its true law
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

UNKNOWN = 1e8
"""Variance of what nobody knows, in that of a reading [1]."""


class Innovations:
    """The filter of a case: of a walk, or of ground that comes back or goes on.

    The state of a mode has where the ground is, its last step, and an orbit that stays: ground that
    comes back does so to an orbit that nobody knows. A walk needs none besides its beginning.
    """

    def __init__(self, case: Conditions) -> None:
        self.noise = case.noise
        powers, laws = [], []
        self.modes = np.zeros((len(case.noise),) * 2)
        for plane in case.all_planes:
            law, part = case.ground_laws[plane], case.bpm_columns(plane)
            moved = case.quad_kicks[plane] - case.quad_kicks[plane][0]
            steps = moved[1:] - law.keep * moved[:-1]
            orbit = steps @ case.lattice.response(case.bpms, case.lattice.quads, plane).T
            orbit = orbit / self.noise[part]
            power, self.modes[part, part] = np.linalg.eigh(orbit.T @ orbit / len(orbit))
            powers.append(np.maximum(power, 1e-6))
            laws += [law] * len(power)
        self.power = np.concatenate(powers)
        self._keep = np.array([law.keep for law in laws])
        self._on = np.array([law.on for law in laws])

    def whiten(self, difference: Array) -> Array:
        """Turn a difference of readings (rows, n) [m] into whitened innovations."""
        modes = difference / self.noise @ self.modes
        state = np.zeros((3, modes.shape[1]))
        white = np.empty_like(modes)
        shares, totals = self.gains(len(modes))
        for row, seen in enumerate(modes):
            new = seen - self.seen(state)
            white[row] = new / np.sqrt(totals[row])
            state = self.next(state, shares[row], new)
        return white

    def seen(self, state: Array) -> Array:
        """What a state (3, …, modes) shows, shape (…, modes)."""
        return state[0] + state[2]

    def next(self, state: Array, share: Array, new: Array) -> Array:
        """State (3, …, modes) of the next row, once an innovation (…, modes) is known."""
        place, step, still = (
            before + known * new for before, known in zip(state, share, strict=True)
        )
        step = self._on * step
        return np.stack([self._keep * place + step, step, still])

    def gains(self, rows: int) -> tuple[Array, Array]:
        """Give the gain of every row and mode and the variance of its innovation.

        Returns:
            Shape (rows, 3, modes), and shape (rows, modes).
        """
        count = len(self.power)
        walks = self._keep == 1.0
        doubt = np.zeros((3, 3, count))
        doubt[0, 0] = np.where(walks, UNKNOWN, self.power / np.maximum(1 - self._keep**2, 1e-9))
        doubt[1, 1] = self.power
        doubt[2, 2] = np.where(walks, 0.0, UNKNOWN)
        fresh = (1 - self._on**2) * self.power
        shares, totals = np.empty((rows, 3, count)), np.empty((rows, count))
        for row in range(rows):
            along = doubt[:, 0] + doubt[:, 2]
            totals[row] = along[0] + along[2] + 1.0
            shares[row] = along / totals[row]
            left = doubt - along[:, None] * along / totals[row]
            step = self._on**2 * left[1, 1] + fresh
            place = self._keep**2 * left[0, 0] + 2 * self._keep * self._on * left[0, 1] + step
            both = self._keep * self._on * left[0, 1] + step
            still = self._keep * left[0, 2] + self._on * left[1, 2]
            doubt = np.array(
                [
                    [place, both, still],
                    [both, step, self._on * left[1, 2]],
                    [still, self._on * left[1, 2], left[2, 2]],
                ]
            )
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
