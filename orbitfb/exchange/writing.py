"""Write a file whole or not at all."""

from pathlib import Path

from orbitfb.core.errors import ExchangeError
from orbitfb.core.files.state import AS_USUAL
from orbitfb.core.files.whole import replace_file


def write_whole(path: Path, content: bytes) -> None:
    """Write beside the place, then rename.

    Raises:
        ExchangeError: It cannot be written; what was there before stays.
    """
    try:
        replace_file(path, content, AS_USUAL)
    except OSError as error:
        raise ExchangeError(
            f"{path} cannot be written ({error.strerror}); make room or name another place"
        ) from error
