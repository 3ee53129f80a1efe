"""A trainer in a process of its own, so that heavy arithmetic cannot disturb the tick.

The child is `python -m orbitfb.learn`: a lower priority, one thread for matrix products, no
EPICS, no files. It ends when its standard input does, so that it cannot outlive its parent,
however that dies. It gets one task at a time; when it dies, the task is answered with what is
known of its end, and the next one goes to a new child that begins with the response of the
incumbent and the last rows in memory.
"""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import IO

from orbitfb.core.transitions import Transitions
from orbitfb.learn.messages import (
    AnswerMessage,
    PackedPolicy,
    TaskMessage,
    TrainerJob,
    pack,
    unpack,
)
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.trainer import MOST_ROWS, Answer, Task

SINGLE_THREADED = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
_RESTART_AFTER = 10.0
_TO_END = 0.2
_LAST_WORDS = 2000


class ProcessTrainer:
    """Runs `python -m orbitfb.learn` and talks to it.

    Args:
        job: What the child must know; the response is replaced by the incumbent's at a restart.
        monotonic: Now [s].
    """

    def __init__(self, job: TrainerJob, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._job, self._monotonic = job, monotonic
        self._response = job.response
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._connection: Connection | None = None
        self._running = False
        self._busy: str | None = None
        self._known: str | None = None
        self._last_tick: int | None = None
        self._retry = monotonic()
        self._lost: Answer | None = None
        self._start()

    @property
    def settings(self) -> LearnSettings:
        """How to identify, judge and watch."""
        return self._job.learn

    @property
    def last_tick(self) -> int | None:
        """Tick of the last row that the child has; None before the first."""
        return self._last_tick

    @property
    def pid(self) -> int | None:
        """Process id of the child; None while there is none."""
        return None if self._process is None else self._process.pid

    @property
    def ready(self) -> bool:
        """Whether the child runs and has nothing to do.

        A dead one is noticed here, and a new one is started here.
        """
        if self._busy is not None or self._lost is not None:
            return False
        if self._connection is None:
            if self._monotonic() >= self._retry:
                self._start()
            return False
        said = self._receive()
        if said is not None and not self._running:
            self._send(replace(self._job, response=self._response))
            self._running = True
        return self._running

    def submit(self, task: Task) -> None:
        """Send a task.

        Args:
            task: Rows beyond the newest 2,000 are left out.
        """
        self._busy = task.trigger or "periodic"
        message = self._message(task)
        if self._send(message):
            self._known = message.incumbent
            self._response = getattr(task.incumbent, "response", self._response)

    def collect(self) -> Answer | None:
        """Give the answer when it is there; it never waits."""
        if self._lost is not None:
            answer, self._lost = self._lost, None
            self._busy = None
            return answer
        if self._busy is None:
            return None
        message = self._receive()
        if not isinstance(message, AnswerMessage):
            return None
        self._busy = None
        self._last_tick = message.last_tick
        candidate = None if message.candidate is None else unpack(message.candidate)
        return replace(message.answer, candidate=candidate)

    def close(self) -> None:
        """End the child: its input ends, and it is killed when it does not heed that."""
        process = self._process
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if process is not None:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(0.5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            self._process = None
        if self._errors is not None:
            self._errors.close()
            self._errors = None
        self._running = False

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the child
            self._process = subprocess.Popen(
                [sys.executable, "-m", "orbitfb.learn", str(theirs.fileno())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                pass_fds=(theirs.fileno(),),
                env=os.environ | SINGLE_THREADED,
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        self._running = False
        self._known, self._last_tick = None, None

    def _send(self, message: object) -> bool:
        """Tell the child something; a dead one is buried."""
        if self._connection is None:
            return False
        try:
            self._connection.send(message)
        except OSError:
            self._bury()
            return False
        return True

    def _message(self, task: Task) -> TaskMessage:
        new = task.incumbent.policy_id != self._known
        packed: PackedPolicy | None = pack(task.incumbent) if new else None
        return TaskMessage(
            _newest(task.transitions),
            task.incumbent.policy_id,
            packed,
            task.trigger,
            task.may_refit,
            task.afresh,
        )

    def _receive(self) -> object | None:
        """Take what the child said; None when it said nothing. A dead one is buried."""
        connection = self._connection
        if connection is None:
            return None
        try:
            return connection.recv() if connection.poll() else None
        except (EOFError, OSError):
            self._bury()
            return None

    def _bury(self) -> None:
        """Let go of a child that has died; what it was doing is answered with that."""
        words, pid = self._last_words(), self.pid
        self.close()
        self._last_tick = None
        self._retry = self._monotonic() + _RESTART_AFTER
        self._lost = Answer(
            self._busy or "periodic",
            failure=f"the trainer's process {pid} ended ({words}); a new one begins with the "
            f"incumbent's response in {_RESTART_AFTER:g} s",
        )

    def _last_words(self) -> str:
        """Say what it died of: the last line it wrote, or the signal that killed it."""
        silence = "it said nothing"
        try:
            status = 0 if self._process is None else self._process.wait(_TO_END)
        except subprocess.TimeoutExpired:
            status = 0  # its connection is gone, but not yet the process
        if status < 0:
            silence = f"killed by signal {-status}"
        if self._errors is None:
            return silence
        self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, self._errors.tell() - _LAST_WORDS))
        said = self._errors.read().decode(errors="replace").strip()
        return said.splitlines()[-1] if said else silence


def _newest(transitions: Transitions) -> Transitions:
    """Leave out the oldest rows beyond the most that are sent."""
    return transitions.part(-MOST_ROWS)
