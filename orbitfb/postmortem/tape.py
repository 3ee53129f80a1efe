"""The last ticks and events in memory, and the moment at which they are to be frozen."""

from collections import deque

from orbitfb.core.ports import Clock
from orbitfb.core.signals import LoopState, TickRecord
from orbitfb.postmortem.frozen import Cause, Event, Frozen, Tick, Trigger
from orbitfb.postmortem.settings import PostMortemSettings

MOST_EVENTS = 2000
"""Events that are kept at most."""
GRACE = 0.5
"""How long after its time a trip waits for a tick, before it is frozen without one [s]."""

_ROUNDING = 1e-6
_CAUSES = {LoopState.TRIPPED: Trigger.TRIP, LoopState.FAULT: Trigger.FAULT}


class Tape:
    """Keeps references to the last records; nothing is copied before a trip.

    Not safe for threads: whoever uses it from several holds a lock.

    Args:
        settings: How much is kept.
        clock: The loop's.
    """

    def __init__(self, settings: PostMortemSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self._ticks: deque[Tick] = deque(maxlen=settings.most_ticks)
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._pending: list[Cause] = []

    def tick(self, record: TickRecord) -> list[Frozen]:
        """Take a record; give what is complete now."""
        now = self._clock.monotonic()
        last = self._ticks[-1].record.state if self._ticks else None
        self._ticks.append(Tick(now, self._clock.wall(), record))
        trigger = _CAUSES.get(record.state)
        if trigger is not None and record.state is not last:
            wall = self._ticks[-1].wall
            self._pending.append(
                Cause(trigger, now, wall, record.tick, record.state, last, record.reason)
            )
        made = self._due(now)
        oldest = now - self._settings.before - self._settings.after - _ROUNDING
        while self._ticks and self._ticks[0].monotonic < oldest:
            self._ticks.popleft()
        return made

    def tell(self, level: str, name: str, fields: dict[str, object]) -> None:
        """Take an event."""
        event = Event(self._clock.monotonic(), self._clock.wall(), level, name, fields)
        self._events.append(event)

    def overdue(self) -> list[Frozen]:
        """Give what waited for a tick that did not come."""
        return self._due(self._clock.monotonic() - GRACE)

    def next_due(self) -> float | None:
        """Say how long it takes until something may be overdue [s]; None: nothing waits."""
        if not self._pending:
            return None
        due = self._pending[0].monotonic + self._settings.after + GRACE
        return max(0.0, due - self._clock.monotonic())

    def finish(self) -> list[Frozen]:
        """Give what still waits, as far as it came: the loop has ended."""
        pending, self._pending = self._pending, []
        return [self._cut(cause) for cause in pending]

    def now(self, who: str) -> Frozen:
        """Freeze at once.

        Args:
            who: Who asked for it.
        """
        last = self._ticks[-1].record if self._ticks else None
        return self._cut(
            Cause(
                Trigger.COMMAND,
                self._clock.monotonic(),
                self._clock.wall(),
                last.tick if last else -1,
                last.state if last else None,
                self._ticks[-2].record.state if len(self._ticks) > 1 else None,
                who,
            )
        )

    def _due(self, now: float) -> list[Frozen]:
        made: list[Frozen] = []
        while (
            self._pending and now >= self._pending[0].monotonic + self._settings.after - _ROUNDING
        ):
            made.append(self._cut(self._pending.pop(0)))
        return made

    def _cut(self, cause: Cause) -> Frozen:
        begin = cause.monotonic - self._settings.before - _ROUNDING
        end = cause.monotonic + self._settings.after + _ROUNDING
        return Frozen(
            cause,
            tuple(tick for tick in self._ticks if begin <= tick.monotonic <= end),
            tuple(event for event in self._events if begin <= event.monotonic <= end),
        )
