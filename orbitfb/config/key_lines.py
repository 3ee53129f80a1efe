"""Where the keys of a TOML text stand, so that what is wrong is told with its line."""

import re
from collections.abc import Iterator

_HEADER = re.compile(r"^\s*\[\[?\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*[A-Za-z0-9_"'-]+)*)\s*=""")


def key_lines(text: str) -> Iterator[tuple[str, int]]:
    """Yield every key of a TOML text by dotted path with the line where it stands."""
    table = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = _plain(header.group(1))
            yield table, number
        elif key := _KEY.match(line):
            name = _plain(key.group(1))
            yield (f"{table}.{name}" if table else name), number


def _plain(dotted: str) -> str:
    return ".".join(part.strip().strip("\"'") for part in dotted.split("."))
