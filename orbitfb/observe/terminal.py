"""The live status in the terminal, drawn by a thread of its own."""

import math
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import TextIO

import structlog
from rich.console import Console
from rich.live import Live

from orbitfb.observe.settings import TerminalSettings
from orbitfb.observe.statistics.snapshot import LoopSnapshot
from orbitfb.observe.view import Surroundings, line, panel
from orbitfb.observe.wording import time_of_day

TREND_STEP = 1.0
"""Time from bar to bar of the trend [s]."""

GOODBYE = 1.0
"""How long `stop` waits for the last picture [s]."""


class Trend:
    """The orbit RMS of the past, one value per step."""

    def __init__(self) -> None:
        self.values: deque[float] = deque(maxlen=100)
        self._next = -math.inf

    def add(self, snapshot: LoopSnapshot) -> None:
        """Take the RMS of a snapshot if a step has passed since the last one."""
        if snapshot.duration >= self._next and snapshot.state is not None:
            self.values.append(snapshot.orbit.observed.now)
            self._next = snapshot.duration + TREND_STEP


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Say that the reader has gone; the base class would end the process's output."""
        raise BrokenPipeError("the reader of the status has gone")


class Terminal:
    """Show the status of the loop until it is stopped.

    On a terminal a panel is drawn in place; elsewhere a line is written now and then, and one for
    everything that happens. What goes wrong here is logged and never reaches the loop.

    Args:
        snapshot: Returns the figures of this moment.
        settings: Panel or lines, and how often.
        around: What to say beside the figures.
        stream: Where to; stdout by default.
    """

    def __init__(
        self,
        snapshot: Callable[[], LoopSnapshot],
        settings: TerminalSettings,
        around: Surroundings,
        stream: TextIO | None = None,
    ) -> None:
        self._snapshot = snapshot
        self._settings = settings
        self._around = around
        self._stream = stream or sys.stdout
        self._done = threading.Event()
        self._thread: threading.Thread | None = None
        self._trend = Trend()
        self._told = 0

    def start(self) -> None:
        """Begin to show; nothing happens when the settings say so."""
        if self._settings.mode == "off" or self._thread is not None:
            return
        console = _Console(file=self._stream)
        live = self._settings.mode == "live" or (
            self._settings.mode == "auto" and console.is_terminal and not console.is_dumb_terminal
        )
        self._thread = threading.Thread(
            target=self._guard,
            args=((lambda: self._draw(console)) if live else self._write,),
            name="orbitfb-terminal",
            daemon=True,
        )
        self._thread.start()

    def stop(self) -> None:
        """Show the last figures and give the terminal back. May be called twice."""
        self._done.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(GOODBYE)

    def _guard(self, show: Callable[[], None]) -> None:
        """Outermost guard of the thread: a terminal that goes away must not stop the loop."""
        try:
            show()
        except Exception:
            structlog.stdlib.get_logger("orbitfb.observe").exception("terminal_status_failed")

    def _draw(self, console: Console) -> None:
        with Live(console=console, auto_refresh=False, redirect_stderr=False) as live:
            last = False
            while not last:
                last = self._done.wait(1.0 / self._settings.rate)
                snapshot = self._snapshot()
                self._trend.add(snapshot)
                view = panel(
                    snapshot, self._trend.values, self._around, (console.width, console.height)
                )
                live.update(view, refresh=True)

    def _write(self) -> None:
        next_line = -math.inf
        last = False
        while not last:
            last = self._done.wait(1.0 / self._settings.rate)
            snapshot = self._snapshot()
            text = self._news(snapshot)
            if last or snapshot.duration >= next_line:
                text += line(snapshot) + "\n"
                next_line = snapshot.duration + self._settings.line_period
            if text:
                self._stream.write(text)
                self._stream.flush()

    def _news(self, snapshot: LoopSnapshot) -> str:
        """Return a line for each thing that happened since the last call."""
        news = [
            f"{time_of_day(happening.time)} {happening.kind}: {happening.text}\n"
            for happening in snapshot.happenings
            if happening.number > self._told
        ]
        if snapshot.happenings:
            self._told = snapshot.happenings[-1].number
        return "".join(news)
