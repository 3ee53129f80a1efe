"""The process that looks; `GapProcess` starts it as `python -m orbitfb.diagnose.live N`."""

import contextlib
import os
import sys
import threading
from multiprocessing.connection import Connection

from orbitfb.core.gap import GapSight
from orbitfb.core.transitions import Transitions
from orbitfb.diagnose.live.look import look
from orbitfb.diagnose.live.process import Look
from orbitfb.diagnose.live.rows import record_of
from orbitfb.records.layout import Layout

_NICE = 19


def main(descriptor: int) -> None:
    """Look when asked, until the parent closes the connection.

    Args:
        descriptor: The child's end of the pair of sockets.
    """
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    os.nice(_NICE)
    with Connection(descriptor) as connection, contextlib.suppress(EOFError, ConnectionError):
        layout: Layout = connection.recv()
        while True:
            asked: Look = connection.recv()
            try:
                answer = seen(asked.transitions, layout)
            except Exception as error:  # the outermost guard: the parent gets the message
                connection.send(repr(error))
                continue
            connection.send(answer)


def seen(transitions: Transitions, layout: Layout) -> GapSight | None:
    """Look at transitions; None if too few of them can be used."""
    record = record_of(transitions, layout)
    return None if record is None else look(record, float(transitions.next_time[-1]))


def _end_with_parent() -> None:
    """End at once if the parent has ended, even in the middle of a look."""
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(0)


if __name__ == "__main__":
    main(int(sys.argv[1]))
