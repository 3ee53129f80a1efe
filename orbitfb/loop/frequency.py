"""The loop lets the RF frequency follow the energy that its correctors would make up.

What is decided is in `safety.frequency`; here it meets the machine and the policy in force.
"""

import math
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import WriteError
from orbitfb.core.names import RF_FREQUENCY, RF_READBACK, RF_STEP
from orbitfb.core.ports import Oscillator
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.core.values import replace
from orbitfb.estimation.columns import KnownRf
from orbitfb.loop.memory import LoopMemory
from orbitfb.physics.frequency import FrequencyModel, undoing
from orbitfb.safety.frequency import (
    UNKNOWN,
    Frequency,
    Pattern,
    SentStep,
    answer,
    closed,
    column_fault,
    compare,
    next_step,
    noted,
    stepped,
)
from orbitfb.safety.rf_settings import RfSettings

LEAST_SHARE = 0.3
"""Least part of the energy of a step that the correctors must take back. On the default ring it is
1.6, with every second corrector 1.4; 0 is a pattern that has nothing to do with the energy."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the frequency that is wanted.

    Args:
        hertz: The step [Hz].
        change: Change of the setpoints that takes it over, shape (m,) [A].
        orbit: What the step alone does to the orbit, shape (n,) [m].
    """

    hertz: float
    change: Vector
    orbit: Vector


@dataclass(frozen=True, slots=True)
class Sight:
    """How the frequency is, for whoever asks.

    Args:
        following: Whether it follows while the loop is closed.
        reason: Why it does not, or waits; empty: nothing to say.
        frequency: That the loop has put, or found at closing [Hz]; NaN: none.
        energy: Relative energy that the correctors make since the loop settled [1]; NaN: not known.
        steps: Steps since the loop was built.
        last_step: The last one [Hz]; NaN: there was none.
        ratio: RF column in use over that of the places table, the size of both [1]; NaN: there was
            no step.
    """

    following: bool = False
    reason: str = "off"
    frequency: float = math.nan
    energy: float = math.nan
    steps: int = 0
    last_step: float = math.nan
    ratio: float = math.nan


class Follower:
    """Steps the frequency of a closed loop.

    Args:
        oscillator: The RF.
        model: What frequency and correctors do.
        settings: Limits.
        noise: Of one BPM reading, rms [m].
        ramp: Of the gain after closing [s]. What the correctors do until the loop has settled
            belongs to the orbit that it found, and not to an energy that drifts.

    Attributes:
        wanted: Whether it shall follow; any thread may put another value here.
        sight: How it is; any thread may read it.
    """

    def __init__(
        self,
        oscillator: Oscillator,
        model: FrequencyModel,
        settings: RfSettings,
        noise: float,
        ramp: float = 0.0,
    ) -> None:
        self._oscillator, self._model = oscillator, model
        self._settings, self._noise = settings, noise
        self._settled_after = ramp + settings.settle
        self.wanted = True
        self.sight = Sight(True, "")
        self._anew = False
        self._pattern: tuple[Vector, Mask, Pattern] | None = None
        self._last, self._ratio = 0.0, math.nan

    def again(self) -> None:
        """Begin anew from here at the next tick, whatever has stopped it."""
        self._anew = True

    def tell(self, reading: Reading) -> Reading:
        """Add to a reading by how much the frequency was changed since the orbit before."""
        last, self._last = self._last, 0.0
        return replace(reading, auxiliary={**reading.auxiliary, RF_STEP: last})

    def look(self, memory: LoopMemory, reading: Reading) -> LoopMemory:
        """See what has become of the last step, and whether the frequency is where it was put.

        Args:
            memory: So far.
            reading: The orbit of this tick.
        """
        rf, orbit = memory.frequency, reading.orbit
        if self._anew:
            rf, self._anew = closed(rf), False
        slow, pv = reading.auxiliary, self._settings.readback_pv
        setpoint = slow.get(RF_FREQUENCY, math.nan)
        readback = slow.get(RF_READBACK, math.nan) if pv else None
        resting = memory.state not in (LoopState.CLOSED, LoopState.HELD)
        if resting or math.isnan(rf.home):
            known = math.isfinite(setpoint)
            rf = replace(closed(rf), home=setpoint, waits="" if known else UNKNOWN)
        if memory.state is not LoopState.CLOSED:
            rf = replace(rf, sent=None, energies=())
        else:
            if rf.base is None and reading.received - memory.since >= self._settled_after:
                known = bool(np.isfinite(memory.setpoints).all())
                rf = replace(rf, base=memory.setpoints.copy()) if known else rf
            if self._pattern is not None:
                rf = answer(rf, orbit.position, orbit.valid, self._pattern[2], self._noise)
            rf = compare(rf, setpoint, readback, reading.received, self._settings)
            if rf.base is not None:
                energy = float(self._model.energy @ (memory.setpoints - rf.base))
                rf = noted(rf, energy)
        self._show(rf)
        return replace(memory, frequency=rf)

    def propose(
        self,
        memory: LoopMemory,
        reading: Reading,
        response: Vector | None,
        mine: Mask,
        known: KnownRf | None = None,
    ) -> tuple[Step | None, LoopMemory]:
        """Say which step is to be made with this tick.

        Args:
            memory: Of a closed loop.
            reading: The orbit of this tick.
            response: R of the policy in force, shape (n, m) [m/A]; None: it has none.
            mine: Correctors that the loop moves, shape (m,).
            known: What the policy in force knows of the RF; None: what the places table tells.
        """
        rf, settings = memory.frequency, self._settings
        idle = not self.wanted or response is None or rf.stopped
        if idle or response is None or not abs(rf.energy) >= settings.dead_band:
            return None, memory
        column = self._model.response if known is None else known.response
        told = self._model.response
        ratio = float(column @ told) / float(told @ told)
        if fault := column_fault(ratio):
            rf = replace(rf, stopped=f"the RF column of the policy in force is not used: {fault}")
            return None, replace(memory, frequency=rf)
        pattern = self._undoing(response, mine, column)
        self._ratio = ratio
        if -pattern.energy / self._model.per_hertz < LEAST_SHARE:
            rf = replace(
                rf,
                stopped="the correctors that move cannot take the energy of an RF step back: "
                "enable more of them, or see the dispersion of the places table",
            )
            return None, replace(memory, frequency=rf)
        hertz, rf = next_step(
            rf,
            pattern,
            reading.orbit.valid,
            reading.received,
            self._oscillator.limits,
            self._noise,
            settings,
        )
        memory = replace(memory, frequency=rf)
        if hertz == 0.0:
            return None, memory
        return Step(hertz, hertz * pattern.change, hertz * pattern.orbit), memory

    def put(self, step: Step, memory: LoopMemory, now: float) -> tuple[bool, LoopMemory]:
        """Send a step, before the setpoints that go with it.

        Args:
            step: To make.
            memory: Of a closed loop.
            now: Monotonic [s].

        Returns:
            Whether it was sent, and the memory.
        """
        rf = memory.frequency
        try:
            self._oscillator.put(rf.aim + step.hertz)
        except WriteError as error:
            return False, replace(memory, frequency=replace(rf, waits=str(error)))
        self._last = step.hertz
        taken = float(self._model.energy @ step.change)
        return True, replace(memory, frequency=stepped(rf, step.hertz, now, taken))

    def sent(self, step: Step, memory: LoopMemory, reading: Reading, moved: Vector) -> LoopMemory:
        """Await the answer to a step, now that the setpoints that go with it are sent too.

        Args:
            step: That was made.
            memory: Of a closed loop.
            reading: The orbit of this tick.
            moved: What the change of the setpoints does to the orbit, shape (n,) [m].
        """
        orbit = reading.orbit
        sent = SentStep(step.hertz, orbit.position, orbit.valid, moved)
        return replace(memory, frequency=replace(memory.frequency, sent=sent))

    def _undoing(self, response: Vector, mine: Mask, orbit: Vector) -> Pattern:
        known = self._pattern
        same = known is not None and known[0] is response and known[2].orbit is orbit
        if same and known is not None and np.array_equal(known[1], mine):
            return known[2]
        change = undoing(response, orbit, mine)
        pattern = Pattern(orbit, change, float(self._model.energy @ change))
        self._pattern = response, mine.copy(), pattern
        return pattern

    def _show(self, rf: Frequency) -> None:
        reason = (rf.stopped or rf.waits) if self.wanted else "off by command"
        following = self.wanted and not rf.stopped
        last = rf.steps[-1] if rf.steps else math.nan
        self.sight = Sight(following, reason, rf.aim, rf.energy, rf.count, last, self._ratio)
