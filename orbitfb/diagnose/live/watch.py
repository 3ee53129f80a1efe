"""A thread of the service that asks for a look at the gap once a period."""

import threading
from collections.abc import Callable, Sequence

from orbitfb.core.errors import EstimationError
from orbitfb.core.gap import GapSight
from orbitfb.core.transitions import Transitions
from orbitfb.diagnose.live.broken import Broken, Source, broken_at_sight
from orbitfb.diagnose.settings import LiveSettings

FEWEST = 250
"""Fewest closed ticks before the first look."""


class GapWatch(threading.Thread):
    """Looks at the gap once a period.

    Args:
        settings: Period and number of ticks.
        history: The last transitions.
        look: Looks at transitions; it returns None if there are too few.
        publish: Receives every result, in this thread; it must not raise.
        failed: Receives the reason of a failed look; it must not raise.
    """

    def __init__(
        self,
        settings: LiveSettings,
        history: Source,
        look: Callable[[Transitions], GapSight | None],
        publish: Callable[[GapSight], None],
        failed: Callable[[EstimationError], None] = lambda _: None,
    ) -> None:
        super().__init__(name="gap-watch", daemon=True)
        self._settings, self._history, self._look = settings, history, look
        self._publish, self._failed = publish, failed
        self._stop_event = threading.Event()
        self._last_tick = -1
        self._broken: tuple[Broken, ...] = ()

    def broken(self) -> Sequence[Broken]:
        """List the devices that the last look found broken; may be called from any thread."""
        return self._broken if self._settings.screen else ()

    def run(self) -> None:
        """Look until stopped."""
        while not self._stop_event.wait(self._settings.period):
            self.step()

    def step(self) -> None:
        """Look once, if there are new ticks."""
        transitions = self._history.snapshot(last=self._settings.window)
        usable = int((transitions.closed & transitions.by_correctors().usable).sum())
        if usable < FEWEST or int(transitions.tick[-1]) == self._last_tick:
            return
        self._last_tick = int(transitions.tick[-1])
        try:
            sight = self._look(transitions)
        except EstimationError as error:
            if not self._stop_event.is_set():
                self._failed(error)
            return
        if sight is not None:
            self._broken = broken_at_sight(sight)
            self._publish(sight)

    def stop(self, end: Callable[[], None] = lambda: None) -> None:
        """End the thread.

        Args:
            end: Ends the process for which the thread may wait.
        """
        self._stop_event.set()
        end()
        if self.is_alive():
            self.join(1.0)
