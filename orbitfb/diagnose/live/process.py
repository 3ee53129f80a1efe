"""A process of low priority that looks at the gap.

A look computes for seconds and would hold the interpreter's lock in the middle of a tick. So it
runs in a process of its own, `python -m orbitfb.diagnose.live`, which starts with the first look
and ends with its parent.
"""

import os
import socket
import subprocess
import sys
from dataclasses import dataclass
from multiprocessing.connection import Connection

from orbitfb.core.errors import EstimationError
from orbitfb.core.gap import GapSight
from orbitfb.core.transitions import Transitions
from orbitfb.records.layout import Layout

SINGLE_THREADED = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
_LONGEST = 300.0
_TO_END = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A request for a look at transitions."""

    transitions: Transitions


class GapProcess:
    """The process that looks.

    Args:
        layout: Layout of all channels, with the model that is tested.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    def look(self, transitions: Transitions) -> GapSight | None:
        """Look at transitions; wait for the answer.

        Returns:
            None if too few of them can be used.

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
                raise EstimationError(f"the look at the gap took longer than {_LONGEST:g} s")
            answer = connection.recv()
        except (OSError, EOFError, TypeError) as error:
            # TypeError: closed by another thread in the middle of a message.
            self.close()
            raise EstimationError(f"the process that looks at the gap ended: {error!r}") from error
        except EstimationError:
            self.close()
            raise
        if isinstance(answer, str):
            raise EstimationError(f"the look at the gap failed: {answer}")
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
        # Last: a thread that waits for an answer is woken by the end of the process.
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "orbitfb.diagnose.live", str(theirs.fileno())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                env=os.environ | SINGLE_THREADED,
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        self._connection.send(self._layout)
