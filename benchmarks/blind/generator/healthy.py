"""The small errors that every device has, beside which an effect on it is seen.

Who knows that gains scatter by a per cent and gradients by what beats by one or two, but not the
error of each device, sees less of an effect that acts like such an error.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, Maker
from benchmarks.blind.generator.machine import Log, Nature
from benchmarks.blind.generator.nature_actuator import Scaled
from benchmarks.blind.generator.nature_sensor import Gain
from benchmarks.blind.generator.oracle import Innovations
from benchmarks.blind.generator.rings import Array

GAIN = 0.01
"""Scatter of gains, as `drawing` has it."""
_BLOCK = 40


def healthy_errors(case: Conditions, maker: Maker, draft: Draft) -> list[Nature]:
    """Make an error of one standard deviation for each device that an effect sits on."""
    if draft.law != "mean":
        return []

    def columns(names: Sequence[str]) -> list[int]:
        return [i for i, name in enumerate(names) if name in draft.places]

    if maker.stage == "sensor":
        return [Gain(np.array([i]), GAIN) for i in columns(case.bpm_names)]
    if maker.stage == "actuator":
        return [Scaled(np.array([i]), GAIN) for i in columns(case.corr_names)]
    return []


class HealthyGradients:
    """Errors of all quadrupoles at once, beside which an effect on the optics is seen.

    The error of a quadrupole is proportional to its strength, as it is drawn; its change of the
    readings is an orbit per kick times the orbit in the quadrupole, to first order.

    Args:
        case: Circumstances.
        filter_: Of the case.
    """

    def __init__(self, case: Conditions, filter_: Innovations) -> None:
        lattice = case.lattice
        strength = lattice.ring.strength("QUAD")
        scatter = np.abs(strength) * float(np.std(lattice.errors / strength))
        self._filter = filter_
        self._planes: list[tuple[Array, Array]] = []
        for plane in case.all_planes:
            sign = -1.0 if plane == "x" else 1.0
            orbit = case.kick_orbit(lattice.quads, plane) * (sign * scatter)
            modal = (orbit / filter_.noise[:, None]).T @ filter_.modes
            self._planes.append((modal, case.orbit_at(lattice.quads, plane)))
        self._known: Array | None = None

    def leave(self, white: Array, log: Log) -> float:
        """Tell the d' of a change when all gradients are open within their scatter.

        Args:
            white: The change, whitened, shape (rows, modes).
            log: Of the run; what is known of the gradients is computed at the first call.
        """
        count = len(self._planes[0][0])
        pull, known = np.zeros(count), np.zeros((count, count))
        for first, block in self.changes(log.setpoints[: len(white)]):
            part = white[first : first + len(block)]
            pull += np.einsum("rmq,rm->q", block, part, optimize=True)
            if self._known is None:
                flat = block.reshape(-1, count)
                known += flat.T @ flat
        if self._known is None:
            self._known = known + np.eye(count)
        total = float(np.sum(white**2))
        return float(np.sqrt(max(total - pull @ np.linalg.solve(self._known, pull), 0.0)))

    def changes(self, setpoints: Array) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Whitened changes of some rows by every gradient, each (rows, modes, quadrupoles)."""
        orbits = [setpoints @ at_quads.T for _, at_quads in self._planes]
        states = [np.zeros((3, *modal.shape)) for modal, _ in self._planes]
        share, total = self._filter.gains(len(setpoints))
        block: list[NDArray[np.float32]] = []
        for row in range(len(setpoints)):
            change = np.zeros_like(self._planes[0][0])
            for number, ((modal, _), orbit) in enumerate(zip(self._planes, orbits, strict=True)):
                new = orbit[row][:, None] * modal - self._filter.seen(states[number])
                change += new / np.sqrt(total[row])
                states[number] = self._filter.next(states[number], share[row], new)
            block.append(change.T.astype(np.float32))
            if len(block) == _BLOCK or row == len(setpoints) - 1:
                yield row + 1 - len(block), np.stack(block)
                block = []


def healthy_gradients(
    case: Conditions, maker: Maker, draft: Draft, filter_: Innovations
) -> HealthyGradients | None:
    """Make the healthy gradients beside which an effect on the optics is seen; else None."""
    hidden = maker.stage == "optics" and draft.law == "mean" and bool(np.any(case.lattice.errors))
    return HealthyGradients(case, filter_) if hidden else None
