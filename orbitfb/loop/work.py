"""What a tick has come to so far, and how long each phase of it took."""

from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.ports import Clock
from orbitfb.core.signals import Applied, Phases, Reading, TickRecord, Vector
from orbitfb.core.values import replace
from orbitfb.loop.memory import LoopMemory


@dataclass(slots=True)
class Work:
    """The tick in hand: filled in phase by phase, then frozen into a record.

    Args:
        clock: Monotonic clock.
        setpoints: In force when the orbit was read, shape (m,) [A].
        nothing: Zeros, shape (m,) [A].
        reading: What was read, if anything.
        requested: Change asked for [A]; zeros at first, like the next two.
        dither: Its dither part [A].
        applied: Change that was written [A].
        scale: Factor of the limits.
        written: When the write had left [s since the epoch].
        latency: From the complete orbit to the last setpoint sent [s].
        missed: Orbits missed before this one.
        held_back: Whether nothing was written as the last change does not show yet.
    """

    clock: Clock
    setpoints: Vector
    nothing: Vector
    reading: Reading | None = None
    requested: Vector = field(init=False)
    dither: Vector = field(init=False)
    applied: Vector = field(init=False)
    scale: float = 1.0
    written: float = float("nan")
    latency: float = float("nan")
    missed: int = 0
    held_back: bool = False
    _marks: dict[str, float] = field(default_factory=dict[str, float])
    _mark: float = field(init=False)

    def __post_init__(self) -> None:
        self.requested = self.dither = self.applied = self.nothing
        self._mark = self.clock.monotonic()

    def done(self, phase: str) -> float:
        """Close a phase, or add to it, and return the monotonic time [s]."""
        now = self.clock.monotonic()
        self._marks[phase] = self._marks.get(phase, 0.0) + now - self._mark
        self._mark = now
        return now

    def remember_sent(
        self,
        setpoints: Vector,
        before: Vector,
        applied: Applied,
        began: float,
        memory: LoopMemory,
        lag: int,
    ) -> LoopMemory:
        """Enter what was sent, here and for the readbacks to come.

        Args:
            setpoints: In force now, shape (m,) [A].
            before: In force before anything was sent in this tick, shape (m,) [A].
            applied: What the machine says of the last write.
            began: When that write began, monotonic [s].
            memory: So far.
            lag: Earlier setpoints that a readback may still show; those of the same tick are none.
        """
        again = not np.isnan(self.written)
        change = setpoints - before
        self.applied = np.where(np.isfinite(change), change, 0.0)
        self.written = applied.time
        if self.reading is not None:
            self.latency = applied.monotonic - self.reading.received
        earlier = memory.recent[1:] if again else memory.recent[:lag]
        sent = replace(memory.sent, change=self.applied, waited=0, began=began)
        return replace(memory, recent=(setpoints, *earlier), sent=sent)

    def phases(self) -> Phases:
        """Give the duration of every phase, 0 for those that were not reached."""
        get = self._marks.get
        return Phases(
            get("read", 0.0),
            get("check", 0.0),
            get("decide", 0.0),
            get("limit", 0.0),
            get("act", 0.0),
        )

    def record(
        self, tick: int, memory: LoopMemory, reference: Vector, policy_id: str
    ) -> TickRecord:
        """Freeze it into a record.

        Args:
            tick: Number of the tick.
            memory: After it.
            reference: In force, shape (n,) [m].
            policy_id: In force.
        """
        return TickRecord(
            tick=tick,
            state=memory.state,
            reason=memory.reason,
            reading=self.reading,
            reference=reference,
            setpoints=self.setpoints,
            requested=self.requested,
            dither=self.dither,
            applied=self.applied,
            scale=self.scale,
            written=self.written,
            policy_id=policy_id,
            phases=self.phases(),
            latency=self.latency,
            missed=self.missed,
            held_back=self.held_back,
        )
