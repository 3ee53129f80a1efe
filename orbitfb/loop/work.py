"""What a tick has come to so far, and how long each phase of it took."""

from dataclasses import dataclass, field

from orbitfb.core.ports import Clock
from orbitfb.core.signals import Phases, Reading, Vector


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
