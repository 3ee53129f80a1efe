"""The hand-over of the reference to a fast feedback, in a thread beside the loop."""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import structlog

from orbitfb.app.commands.hand_over import HANDS_OVER, OFF, STOPPED, HandOver
from orbitfb.app.commands.preview import Latest
from orbitfb.app.commands.vectors import MICRO
from orbitfb.app.service.access import RingAccess
from orbitfb.config.tree import AppConfig
from orbitfb.core.ports import Clock
from orbitfb.loop.runner import Runner

_log = structlog.stdlib.get_logger("orbitfb.hand_over")

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]


class HandingOver:
    """Answers `close` and `open` where a fast feedback takes our reference.

    Args:
        hand_over: Decides; None: there is no such fast feedback.
        interval: Time from one step to the next [s].
        tell: Gets a line for people when it begins and when it ends.
    """

    def __init__(
        self, hand_over: HandOver | None, interval: float, tell: Callable[[str], None]
    ) -> None:
        self._hand_over, self._interval, self._tell = hand_over, interval, tell
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="hand-over", daemon=True)

    def start(self) -> None:
        """Start the thread, if there is something to do."""
        if self._hand_over is not None:
            self._thread.start()

    def close(self) -> None:
        """End it; the reference of the fast feedback stays where it is."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def closing(self, otherwise: Handler) -> Handler:
        """Let `close` hand the reference over while the fast feedback is closed."""
        hand_over = self._hand_over

        def close(request: Mapping[str, Any]) -> Mapping[str, Any]:
            if hand_over is None or not hand_over.applies:
                return otherwise(request)
            with self._lock:
                hand_over.begin()
            self._said("begun", "our reference is handed over to the fast feedback")
            return {"hand_over": HANDS_OVER, "left_um": hand_over.sight.left / MICRO}

        return close

    def opening(self, otherwise: Handler) -> Handler:
        """Let `open` end the hand-over, too."""

        def opened(request: Mapping[str, Any]) -> Mapping[str, Any]:
            if self._hand_over is not None and self._hand_over.sight.state == HANDS_OVER:
                with self._lock:
                    self._hand_over.end()
                self._said("ended", "the reference of the fast feedback is left alone")
            return otherwise(request)

        return opened

    @property
    def sight(self) -> dict[str, Any] | None:
        """How it is: `state`, `reason`, `left_um`; None: there is no such fast feedback."""
        if self._hand_over is None:
            return None
        sight = self._hand_over.sight
        left = sight.left / MICRO if sight.left == sight.left else None
        return {"state": sight.state, "reason": sight.reason, "left_um": left}

    def shown(self) -> dict[str, Any]:
        """Give how it is, by PV of the panel, in its units."""
        sight = self.sight or {"state": OFF, "reason": "", "left_um": None}
        return {
            "HandOver-I": sight["state"],
            "HandOverReason-I": sight["reason"],
            "HandOverLeft-I": sight["left_um"],
        }

    def _run(self) -> None:
        hand_over = self._hand_over
        while hand_over is not None and not self._stop.wait(self._interval):
            before = hand_over.sight
            with self._lock:
                hand_over.step()
            after = hand_over.sight
            if before.state == HANDS_OVER and after.state != HANDS_OVER:
                event = "stopped" if after.state == STOPPED else "ended"
                self._said(event, f"the reference is not handed over: {after.reason}")
            elif after.reason and after.reason != before.reason:
                _log.warning("hand_over_waits", reason=after.reason)

    def _said(self, event: str, text: str) -> None:
        tell = _log.warning if event == "stopped" else _log.info
        tell(f"hand_over_{event}", reason=text)
        self._tell(text)


def handing_over(
    config: AppConfig,
    access: RingAccess,
    runner: Runner,
    latest: Latest,
    tell: Callable[[str], None],
    clock: Clock,
    stack: ExitStack,
) -> HandingOver:
    """Make what hands the reference over; its thread runs once `start` was called.

    Args:
        config: The configuration.
        access: The ring as the service reaches it.
        runner: Has our reference.
        latest: Has the status of the fast feedback.
        tell: Gets a line for people when it begins and when it ends.
        clock: The time.
        stack: Ends it.
    """
    settings, channel = config.fast_feedback, config.interlocks.fast_feedback_channel
    reference = access.machine.fast_reference
    hand_over = None
    if reference is not None:

        def status() -> str:
            record = latest.record
            if record is None or record.reading is None:
                return "no orbit has come yet"
            age = clock.monotonic() - record.reading.received
            if age > config.observe.stale_after:
                return f"whether the fast feedback is closed is not known: {age:.1f} s old"
            value = record.reading.auxiliary.get(channel, float("nan"))
            if value == 0.0:
                return f"the fast feedback is open ({channel} is 0)"
            known = value == value
            return "" if known else f"whether the fast feedback is closed ({channel}) is not known"

        hand_over = HandOver(
            reference,
            lambda: runner.adjustments.reference,
            status,
            access.obstacle,
            config.loop.reference_speed * settings.interval,
            settings.tolerance,
        )
    made = HandingOver(hand_over, settings.interval, tell)
    stack.callback(made.close)
    return made
