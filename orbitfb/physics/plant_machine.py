"""The simulated ring in process, behind the port that the loop knows, on virtual time."""

import math

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import MachineError, NoOrbitError, WriteError
from orbitfb.core.names import RF_FREQUENCY, RF_READBACK
from orbitfb.core.signals import Applied, Channels, Mask, Orbit, Reading, Vector
from orbitfb.physics.plant import Plant, PlantState

_STORED_CURRENT = 0.4


class PlantOscillator:
    """The RF of a simulated ring in process: it takes what is put at once.

    Args:
        frequency: At the start [Hz].
        reach: Drive limits, plus and minus from there [Hz].

    Attributes:
        frequency: In force [Hz].
        limits: Drive limits, low and high [Hz].
    """

    def __init__(self, frequency: float, reach: float = 1000.0) -> None:
        self.frequency = frequency
        self.limits = (frequency - reach, frequency + reach)

    def put(self, frequency: float) -> None:
        """Put a frequency in force [Hz].

        Raises:
            WriteError: It is beyond the limits.
        """
        low, high = self.limits
        if not low <= frequency <= high:
            raise WriteError(f"{frequency} Hz is not from {low} to {high} Hz; nothing was put")
        self.frequency = frequency


class PlantMachine:
    """A `Machine` without a network and without waiting.

    Every read lets one tick pass under the setpoints in force, so what is written after orbit n
    shows in orbit n + 1, and moves the clock on to the stamp of the new orbit.

    Args:
        plant: The ring.
        clock: Virtual time; reads move it.
        period: Between two orbits [s].
        corrector_limit: Setpoints beyond it, either sign, are refused [A].

    Attributes:
        current: Stored current that the machine reports [A]; set it to play a beam loss.
        true_orbit_rms: Of the orbit read last [m].
        oscillator: The RF, which moves the beam.
    """

    def __init__(
        self,
        plant: Plant,
        clock: ManualClock,
        period: float = 0.1,
        corrector_limit: float = 18.0,
    ) -> None:
        self.plant = plant
        self.current = _STORED_CURRENT
        self.true_orbit_rms = math.nan
        self._clock, self._period = clock, period
        self._limit = corrector_limit
        self._start = clock.wall() - plant.tick * period
        self._setpoints = np.zeros(len(plant.channels.correctors))
        self._masked = np.zeros(len(plant.channels.bpms), dtype=np.bool_)
        self.oscillator = PlantOscillator(plant.ring.rf_frequency)
        self._failing_reads = 0
        self._failing_writes = 0
        self._last: tuple[PlantState, float] | None = None
        self._frozen = False
        self._closed = False

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        return self.plant.channels

    def read(self, timeout: float) -> Reading:
        """Let one tick pass and return its orbit.

        Args:
            timeout: Time that a read made to fail takes [s].

        Raises:
            NoOrbitError: The read was made to fail.
            MachineError: The machine is closed.
        """
        self._check_open()
        if self._failing_reads > 0:
            self._failing_reads -= 1
            for _ in range(max(1, int(timeout / self._period))):  # the ring does not stop
                self._pass_one_tick()
            raise NoOrbitError(
                f"no orbit within {timeout:.3g} s: this read was made to fail; read again"
            )
        state, stamp = self._pass_one_tick()
        if self._frozen and self._last is not None:
            state, stamp = self._last
        self._last = state, stamp
        self.true_orbit_rms = float(np.sqrt(np.mean(state.true_orbit**2)))
        return Reading(
            orbit=Orbit(
                position=np.where(self._masked, np.nan, state.reading),
                valid=~self._masked,
                time=stamp,
            ),
            readback=state.readback.copy(),
            auxiliary={
                "current": self.current,
                RF_FREQUENCY: self.oscillator.frequency,
                RF_READBACK: self.oscillator.frequency,
                "true_orbit_rms": self.true_orbit_rms,
            },
            received=self._clock.monotonic(),
        )

    def setpoints(self) -> Vector:
        """Absolute setpoints in force, shape (m,) [A]."""
        self._check_open()
        return self._setpoints.copy()

    def write(self, setpoints: Vector, which: Mask | None = None) -> Applied:
        """Put absolute setpoints in force: all that are asked for, or none.

        Args:
            setpoints: Shape (m,) [A].
            which: Correctors to put, shape (m,); None: all.

        Raises:
            WriteError: Wrong shape, a value not finite or beyond the limit, or made to fail.
            MachineError: The machine is closed.
        """
        self._check_open()
        if self._failing_writes > 0:
            self._failing_writes -= 1
            raise WriteError("no setpoint was written: this write was made to fail; write again")
        if setpoints.shape != self._setpoints.shape:
            raise WriteError(
                f"setpoints of shape {setpoints.shape} for {len(self._setpoints)} correctors; "
                "nothing was written"
            )
        limit = self._limit
        wanted = setpoints if which is None else np.where(which, setpoints, self._setpoints)
        refused = np.flatnonzero(~(np.abs(wanted) <= limit))  # so that NaN is refused too
        if refused.size:
            told = ", ".join(f"{self.channels.setpoint_pvs[int(i)]} = {wanted[i]}" for i in refused)
            raise WriteError(f"{told}: not a finite current within ±{limit} A; nothing was written")
        self._setpoints = wanted.astype(np.float64)
        sent = np.array(setpoints, dtype=np.float64)
        return Applied(sent, self._clock.wall(), self._clock.monotonic())

    def close(self) -> None:
        """Let go; setpoints stay where they are."""
        self._closed = True

    def fail_next_reads(self, count: int) -> None:
        """Make the next reads fail; the ring goes on, its orbits are lost."""
        self._failing_reads = count

    def fail_next_writes(self, count: int) -> None:
        """Make the next writes fail and change nothing."""
        self._failing_writes = count

    def mask(self, *bpms: int) -> None:
        """Make BPMs read NaN and be invalid, by their index in the orbit."""
        self._masked[list(bpms)] = True

    def unmask(self) -> None:
        """Make all BPMs valid again."""
        self._masked[:] = False

    def freeze(self) -> None:
        """Repeat the last orbit with its stamp at every read, as a stuck source would."""
        self._frozen = True

    def thaw(self) -> None:
        """Deliver new orbits again."""
        self._frozen = False

    def _pass_one_tick(self) -> tuple[PlantState, float]:
        stamp = self._start + (self.plant.tick + 1) * self._period
        change = self.oscillator.frequency - self.plant.ring.rf_frequency
        state = self.plant.step(self._setpoints, change)
        self._clock.advance(max(0.0, stamp - self._clock.wall()))
        return state, stamp

    def _check_open(self) -> None:
        if self._closed:
            raise MachineError("the simulated machine was closed; build a new one")
