"""A command that takes its time says on a terminal that it has begun, and how long it took."""

import sys
import time
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

P = ParamSpec("P")


def tells_its_time(what: str) -> Callable[[Callable[P, None]], Callable[P, None]]:
    """Decorate a command; lines go to standard error, and only where that is a terminal.

    Args:
        what: What it does, as `reading the history`.
    """

    def around(command: Callable[P, None]) -> Callable[P, None]:
        @wraps(command)
        def timed(*arguments: P.args, **options: P.kwargs) -> None:
            begun, shown = time.monotonic(), sys.stderr.isatty()
            if shown:
                print(f"{what} …", file=sys.stderr, flush=True)
            command(*arguments, **options)
            if shown:
                print(f"{what} took {time.monotonic() - begun:.1f} s", file=sys.stderr)

        return timed

    return around
