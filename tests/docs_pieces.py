"""The blocks of a documentation page and what is to be done with each of them.

What a block is says the word after its three backticks:

    console   commands after `$ `, and below each the output to expect
    sh        commands that must succeed, one a line
    python    a program that must succeed
    toml      a file, named by the comment in its first line; a configuration must be a good one
    json, yaml, ini, promql   a piece of a file; json and yaml must parse
    text      what is printed or drawn; nothing that a reader types

A comment before a block says what else holds, several things separated by `;`:

    <!-- test: skip, REASON -->             do not run the block
    <!-- test: background -->               run its command in another terminal
    <!-- test: wait 5 -->                   first wait so many seconds
    <!-- test: replace "A" by "B" -->       run B where the page says A
    <!-- test: output -->                   this `text` block is what the last program printed
    <!-- test: other -->                    this `toml` block is no configuration

and by themselves, for what a reader has done before he reads the page:

    <!-- test: run COMMAND -->              run it
    <!-- test: start COMMAND -->            run it in another terminal
    <!-- test: until COMMAND -->            run it again and again until it succeeds
    <!-- test: stop -->                     press Ctrl-C in the last of the other terminals
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
COMMANDS = ("console", "sh")
KINDS = (*COMMANDS, "python", "toml", "json", "yaml", "ini", "promql", "text")
ALONE = ("run", "start", "until", "stop")
WITH_BLOCK = ("skip", "background", "wait", "replace", "output", "other")
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "deploy").rglob("*.md")),
]
"""Every page that users read."""

_PIECE = re.compile(
    r"(?:^<!-- test: (?P<orders>(?:(?!-->).)*?) -->\n)?"
    r"^(?P<indent> *)```(?P<kind>[^\n`]*)\n(?P<body>.*?)^ *```$"
    r"|^<!-- test: (?P<alone>(?:(?!-->).)*?) -->$",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Piece:
    """A block of a page with its orders, or an order by itself (its kind is then `alone`)."""

    line: int
    kind: str
    body: str
    orders: tuple[str, ...]

    def order(self, word: str) -> str | None:
        """What follows a word among the orders; None if it is not there."""
        found = [order for order in self.orders if re.match(rf"{word}\b", order)]
        return found[0].removeprefix(word).lstrip(", ") if found else None


def pieces(text: str) -> Iterator[Piece]:
    """Blocks and orders of a page as they stand."""
    for found in _PIECE.finditer(text):
        line = text.count("\n", 0, found.start()) + 1
        given = found["orders"] or ""  # a reason to skip may have a semicolon of its own
        orders = (given,) if given.startswith("skip") else [o.strip() for o in given.split(";")]
        if found["alone"]:
            yield Piece(line, "alone", "", (found["alone"],))
        else:
            indent = found["indent"]
            body = re.sub(rf"^{indent}", "", found["body"], flags=re.MULTILINE)
            yield Piece(line, found["kind"].strip(), body, tuple(filter(None, orders)))


def commands(body: str) -> list[tuple[str, list[str] | None]]:
    """Commands of a block, each with the lines shown below it; None: none are, it must succeed."""
    if not re.search(r"^\$ ", body, re.MULTILINE):
        lines = body.replace("\\\n", " ").splitlines()
        return [(line, None) for line in lines if line.strip() and not line.startswith("#")]
    shown: list[tuple[str, list[str] | None]] = []
    for line in body.splitlines():
        if line.startswith("$ "):
            shown.append((line.removeprefix("$ "), []))
        elif shown and shown[-1][1] is not None:
            shown[-1][1].append(line)
    return shown


def file_name(body: str) -> str | None:
    """Name in the comment of the first line, `# NAME.toml`; None if there is none."""
    found = re.match(r"# ([\w.-]+\.toml)\b", body)
    return found[1] if found else None
