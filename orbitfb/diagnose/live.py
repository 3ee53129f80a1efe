"""The service's watch over its own gap: a thread that asks a process of low priority to look.

The arithmetic of a look takes seconds and would hold the interpreter's lock in the middle of a
tick, so it has a process of its own, `python -m orbitfb.diagnose`, which is started when the first
look is due and ends with its parent.
"""

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection

from orbitfb.core.errors import EstimationError
from orbitfb.core.gap import GapSight
from orbitfb.core.transitions import Transitions
from orbitfb.diagnose.broken import Broken, Source, broken_at_sight
from orbitfb.diagnose.settings import LiveSettings
from orbitfb.records.layout import Layout

SINGLE_THREADED = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
FEWEST = 250
"""Closed ticks before the first look."""
_LONGEST = 300.0
_TO_END = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What is to be looked at."""

    transitions: Transitions


class GapProcess:
    """The process that looks.

    Args:
        layout: Of all channels, with the model that is questioned.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    def look(self, transitions: Transitions) -> GapSight | None:
        """Look at transitions; wait for the answer.

        Returns:
            None when there are too few that can be used.

        Raises:
            EstimationError: The process died, did not answer in time, or failed.
        """
        try:
            if self._connection is None:
                self._start()
            connection = self._connection
            if connection is None:
                raise EOFError
            connection.send(Look(transitions))
            if not connection.poll(_LONGEST):
                raise EstimationError(f"the watch over the gap took longer than {_LONGEST:g} s")
            answer = connection.recv()
        except (OSError, EOFError) as error:
            self.close()
            raise EstimationError(f"the watch over the gap died: {error!r}") from error
        except EstimationError:
            self.close()
            raise
        if isinstance(answer, str):
            raise EstimationError(f"the watch over the gap failed: {answer}")
        return answer

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(_TO_END)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        # Last: who waits for an answer is woken by the end of the process, not by this.
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "orbitfb.diagnose", str(theirs.fileno())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                env=os.environ | SINGLE_THREADED,
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        self._connection.send(self._layout)


class GapWatch(threading.Thread):
    """Looks at the gap once a period.

    Args:
        settings: When, and at how much.
        history: The last transitions.
        look: Looks at transitions; None as an answer: too few.
        publish: Gets every sight, in this thread; it must not raise.
        failed: Gets the reason when a look failed; it must not raise.
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
        """What the last look called broken; from any thread."""
        return self._broken if self._settings.screen else ()

    def run(self) -> None:
        """Look until stopped."""
        while not self._stop_event.wait(self._settings.period):
            self.step()

    def step(self) -> None:
        """Look once, if there is anything new."""
        transitions = self._history.snapshot(last=self._settings.window)
        usable = int((transitions.closed & transitions.usable).sum())
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
        """Let the thread end.

        Args:
            end: Ends what it may be waiting for.
        """
        self._stop_event.set()
        end()
        if self.is_alive():
            self.join(1.0)
