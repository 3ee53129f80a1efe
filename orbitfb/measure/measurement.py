"""A whole measurement: group by group, the setpoints put back on every way out of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import ConfigError, MeasurementError
from orbitfb.core.ports import Clock, Machine
from orbitfb.core.signals import Mask, Vector
from orbitfb.measure.column import Column, Table
from orbitfb.measure.journal import Journal
from orbitfb.measure.mover import Mover, restore_persistently
from orbitfb.measure.multisine import Multisine, design
from orbitfb.measure.settings import MeasureSettings
from orbitfb.measure.stepping import measure_by_steps, orbits_by_steps
from orbitfb.measure.sweeping import measure_at_once, orbits_at_once
from orbitfb.measure.watch import Watch
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.limits import LimitSettings

_LEAST = 0.2
"""Part of the wanted amplitude below which a corrector has too little room."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """A finished measurement.

    Args:
        table: Every movable corrector's column.
        base: Setpoints around which it was measured, shape (m,) [A].
        check: By index of a corrector measured at once, how far its column is from that by
            steps, relative [1]; empty where all went by steps.
    """

    table: Table
    base: Vector
    check: dict[int, float]


class Teller:
    """Is told how far a measurement is; this one keeps it to itself."""

    def begin(self, orbits: int, done: int, total: int) -> None:
        """Take how many orbits it needs if none is rejected, and how many correctors are done."""

    def progress(self, done: int, total: int) -> None:
        """Take how many of how many correctors are done."""

    def played(self, share: float) -> None:
        """Take which share of the waveform of a group at once is over."""


class Measurement:
    """Measures the response matrix of a machine.

    Args:
        machine: The ring.
        nominal: Response by the optics, shape (n, m) [m/A]: sizes the steps, nothing else.
        settings: How to measure.
        limits: Of every write.
        watch: Gives orbits.
        movable: Correctors to measure, shape (m,).
        journal: Keeps what is moved and done.
        clock: Tells the time.
        seed: Of the waveforms at once.
        bounds: Where the setpoint of each may be; None: the same for all, by the limits.
        teller: Told how far it is.
    """

    def __init__(
        self,
        machine: Machine,
        nominal: Vector,
        settings: MeasureSettings,
        limits: LimitSettings,
        watch: Watch,
        movable: Mask,
        journal: Journal,
        clock: Clock,
        seed: int = 0,
        bounds: Bounds | None = None,
        teller: Teller | None = None,
    ) -> None:
        self._bounds = bounds or Bounds.of(limits.setpoint, len(movable))
        self._machine, self._nominal, self._settings = machine, nominal, settings
        self._limits, self._watch, self._movable = limits, watch, movable
        self._journal, self._clock, self._seed = journal, clock, seed
        self._teller = teller or Teller()

    def run(self, table: Table) -> Result:
        """Measure what is not in a table yet.

        Args:
            table: Columns that are done; it is filled.

        Raises:
            StoppedError: Somebody stopped it; the setpoints are back.
            MeasurementError: It was given up; the setpoints are back unless the message says.
            MachineError: The machine failed; the setpoints are back.
            ConfigError: It cannot be done within the limits; nothing was moved.
        """
        same = self._settings.same_setpoint
        mover = Mover(self._machine, self._limits, self._watch, same, self._bounds)
        todo = [int(j) for j in np.flatnonzero(self._movable & ~table.measured)]
        size = self._settings.at_once or max(1, len(todo))
        groups = [todo[k : k + size] for k in range(0, len(todo), size)]
        plans = [self._plan(group, mover.base, size > 1) for group in groups]
        total = int(self._movable.sum())
        self._teller.begin(self._orbits(groups, plans), int(table.measured.sum()), total)
        self._settle_down(mover)
        for group, (amplitudes, wave) in zip(groups, plans, strict=True):
            for j, column in zip(group, self._group(group, amplitudes, wave, mover), strict=True):
                table.put(j, column)
            self._journal.save(table, conditions(self._settings))
            self._teller.progress(int(table.measured.sum()), total)
        check = self._check(table, mover) if size > 1 else {}
        return Result(table, mover.base, check)

    def _orbits(self, groups: list[list[int]], plans: list[tuple[Vector, Multisine | None]]) -> int:
        """Count the orbits of the whole: those watched at first, all groups, the check."""
        settings = self._settings
        steps = orbits_by_steps(settings)
        total = settings.watch
        for group, (_, wave) in zip(groups, plans, strict=True):
            total += steps * len(group) if wave is None else orbits_at_once(wave)
        checked = settings.check if settings.at_once != 1 else 0
        return total + steps * min(checked, int(self._movable.sum()))

    def _settle_down(self, mover: Mover) -> None:
        """See that nobody moves a setpoint, and take the orbit at the start."""
        readings = [self._watch.orbit() for _ in range(self._settings.watch)]
        mover.verify()
        positions = np.array([self._watch.position(reading) for reading in readings])
        known = np.isfinite(positions).sum(axis=0)
        total = np.where(np.isfinite(positions), positions, 0.0).sum(axis=0)
        self._watch.begin(np.where(known > 0, total / np.maximum(known, 1), np.nan))

    def _group(
        self, group: Sequence[int], amplitudes: Vector, wave: Multisine | None, mover: Mover
    ) -> list[Column]:
        """Measure a group; its setpoints are put back whatever happens."""
        self._journal.mark(group, mover.base, self._clock.wall())
        try:
            if wave is None:
                columns = [
                    measure_by_steps(j, float(size), mover, self._watch, self._settings)
                    for j, size in zip(group, amplitudes, strict=True)
                ]
            else:
                columns = measure_at_once(
                    group, amplitudes, wave, mover, self._watch, self._settings, self._teller.played
                )
        finally:
            patience = self._settings.restore_timeout
            restore_persistently(mover, group, self._machine, self._clock, patience)
            self._journal.clear()
        return columns

    def _plan(
        self, group: Sequence[int], base: Vector, at_once: bool
    ) -> tuple[Vector, Multisine | None]:
        """Size the steps of a group within the limits."""
        settings = self._settings
        amplitudes = self._amplitudes(group, base, at_once)
        if not at_once:
            return amplitudes, None
        wave = design(len(group), settings.ticks, settings.lowest, settings.highest, self._seed)
        step = amplitudes * 2.0 * np.sin(np.pi * wave.bins / wave.ticks)
        step = np.maximum(step, amplitudes / 5.0)  # the first one
        if step.max() > self._limits.change_per_tick:
            raise ConfigError(
                f"at once {self._name(group[int(np.argmax(step))])} would change by "
                f"{step.max():.3g} A in a tick; allowed are {self._limits.change_per_tick:g} A "
                "(limits.change_per_tick): make measure.orbit_rms or measure.highest smaller"
            )
        return amplitudes, wave

    def _amplitudes(self, group: Sequence[int], base: Vector, at_once: bool) -> Vector:
        members = list(group)
        rms = np.sqrt(np.mean(self._nominal[:, members] ** 2, axis=0))
        share = np.sqrt(2.0 / len(members)) if at_once else 1.0
        if self._settings.amplitude is not None:
            wanted = np.full(len(members), self._settings.amplitude)
        else:
            wanted = share * self._settings.orbit_rms / np.maximum(rms, 1e-30)
        orbit = wanted * rms / (1.0 if not at_once else np.sqrt(2.0))
        orbit = np.sqrt(np.sum(orbit**2)) if at_once else orbit.max()
        if not orbit <= 0.5 * self._settings.excursion_rms:
            raise ConfigError(
                f"the steps would move the orbit by {orbit * 1e6:.3g} µm rms, more than half of "
                f"measure.excursion_rms ({self._settings.excursion_rms * 1e6:.3g} µm); make them "
                "smaller"
            )
        bounds = self._bounds
        room = np.minimum(bounds.high - base, base - bounds.low)[members]
        tight = np.flatnonzero(~(room >= _LEAST * wanted))
        if tight.size:
            names = ", ".join(self._name(members[int(k)]) for k in tight[:5])
            raise ConfigError(
                f"{tight.size} correctors have no room for a step to both sides within "
                f"±{self._limits.setpoint:g} A (limits.setpoint) or their drive limits: {names}; "
                "unload or mask them"
            )
        return np.minimum(wanted, room)

    def _check(self, table: Table, mover: Mover) -> dict[int, float]:
        """Measure some of the correctors at once by steps as well, and compare."""
        valid = np.isfinite(table.response)
        sizes = np.sqrt(np.mean(np.where(valid, table.response, 0.0) ** 2, axis=0))
        expected = np.sqrt(np.mean(self._nominal**2, axis=0))
        alive = self._movable & (sizes >= self._settings.weakest * expected)
        linear = np.flatnonzero(alive & (table.linearity <= self._settings.linearity))
        count = min(self._settings.check, len(linear))
        if not count:
            raise MeasurementError(
                "none of the correctors moved at once shows a linear response to check by steps; "
                "measure one by one with --fresh --at-once 1"
            )
        chosen = np.random.default_rng(self._seed).choice(linear, count, replace=False)
        found: dict[int, float] = {}
        for j in sorted(int(each) for each in chosen):
            amplitudes = self._amplitudes([j], mover.base, at_once=False)
            column = self._group([j], amplitudes, None, mover)[0]
            valid = np.isfinite(column.response) & np.isfinite(table.response[:, j])
            apart = np.linalg.norm((column.response - table.response[:, j])[valid])
            found[j] = float(apart / max(np.linalg.norm(column.response[valid]), 1e-30))
        worst = max(found, key=lambda j: found[j])
        if not found[worst] <= self._settings.agreement:
            raise MeasurementError(
                f"at once {self._name(worst)} has a column that is {found[worst]:.2g} off that by "
                f"steps; allowed is {self._settings.agreement:g} (measure.agreement); measure one "
                "by one with --fresh --at-once 1"
            )
        return found

    def _name(self, corrector: int) -> str:
        return self._machine.channels.setpoint_pvs[corrector]


def conditions(settings: MeasureSettings) -> dict[str, object]:
    """Tell what columns must have in common to stand in one matrix."""
    return {"at_once": settings.at_once != 1}
