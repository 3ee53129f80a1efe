"""Takes orbits while a measurement runs: which count, and when all must be given up."""

from collections.abc import Callable

import numpy as np

from orbitfb.core.errors import MeasurementError, NoOrbitError, StoppedError
from orbitfb.core.ports import Machine
from orbitfb.core.signals import Mask, Reading, Vector
from orbitfb.measure.settings import MeasureSettings
from orbitfb.safety.bpms import bpm_quota
from orbitfb.safety.interlocks import InterlockSettings, stored_current
from orbitfb.safety.verdict import Action


class Watch:
    """Reads orbits, leaves out those that do not count, and gives up in time.

    An orbit does not count when it is late, has more invalid BPMs than the interlocks allow, or is
    the same as the one before (frozen). Without stored current, too far from the orbit at the
    start, or after too many orbits in a row that did not count, the measurement is given up.

    Args:
        machine: The ring.
        settings: How far the orbit may go, how many orbits may fail.
        interlocks: Stored current, BPM quota, frozen orbits.
        counting: BPMs that are not masked, shape (n,).
        timeout: How long to wait for an orbit [s].
        stopped: Asked before every orbit.

    Attributes:
        rejected: Orbits that did not count so far.
    """

    def __init__(
        self,
        machine: Machine,
        settings: MeasureSettings,
        interlocks: InterlockSettings,
        counting: Mask,
        timeout: float,
        stopped: Callable[[], bool],
    ) -> None:
        self._machine, self._settings, self._interlocks = machine, settings, interlocks
        self._counting, self._timeout, self._stopped = counting, timeout, stopped
        self._origin: Vector | None = None
        self._last: Vector | None = None
        self._repeats = 0
        self.rejected = 0

    def begin(self, orbit: Vector) -> None:
        """Take an orbit for that at the start, shape (n,) [m]."""
        self._origin = orbit.copy()

    def orbit(self) -> Reading:
        """Wait for the next orbit that counts; its masked and invalid BPMs are NaN.

        Raises:
            StoppedError: Somebody stopped the measurement.
            MeasurementError: It must be given up.
        """
        problem = ""
        for _ in range(self._settings.rejected_most + 1):
            if self._stopped():
                raise StoppedError("the measurement was stopped")
            try:
                reading = self._machine.read(self._timeout)
            except NoOrbitError as error:
                problem = str(error)
            else:
                problem = self._problem(reading)
                if not problem:
                    self._check(reading)
                    return reading
            self.rejected += 1
        raise MeasurementError(
            f"more than {self._settings.rejected_most} orbits in a row do not count, the last "
            f"one because: {problem}"
        )

    def position(self, reading: Reading) -> Vector:
        """Give the orbit with NaN where a BPM is masked or not valid, shape (n,) [m]."""
        return np.where(self._counting & reading.orbit.valid, reading.orbit.position, np.nan)

    def _problem(self, reading: Reading) -> str:
        channels = self._machine.channels
        quota = bpm_quota(
            reading.orbit.valid,
            self._interlocks,
            channels.bpms,
            self._counting,
            planes=tuple(channels.bpm_parts.values()),
        )
        if quota.action is Action.HOLD:
            return quota.reason
        position = self.position(reading)
        same = self._last is not None and np.array_equal(position, self._last, equal_nan=True)
        self._repeats = self._repeats + 1 if same else 0
        self._last = position
        if 0 < self._interlocks.frozen_ticks <= self._repeats:
            return f"all BPMs repeat their readings for the {self._repeats}. time: a frozen orbit"
        return ""

    def _check(self, reading: Reading) -> None:
        current = stored_current(reading.auxiliary, self._interlocks, why=reading.unknown)
        if not current.may_act:
            raise MeasurementError(current.reason)
        if self._origin is None:
            return
        away = self.position(reading) - self._origin
        away = away[np.isfinite(away)]
        if not away.size:
            raise MeasurementError("no BPM is left that was valid at the start")
        most_rms, most = self._settings.excursion_rms, self._settings.excursion_max
        rms, largest = float(np.sqrt(np.mean(away**2))), float(np.abs(away).max())
        if not (rms <= most_rms and largest <= most):
            raise MeasurementError(
                f"the orbit is {rms * 1e6:.4g} µm rms, {largest * 1e6:.4g} µm at most away from "
                f"that at the start; allowed are {most_rms * 1e6:.4g} µm (measure.excursion_rms) "
                f"and {most * 1e6:.4g} µm (measure.excursion_max)"
            )
