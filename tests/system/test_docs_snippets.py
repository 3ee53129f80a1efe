"""Pages are done as they stand: their commands in a shell, their Python as programs.

What the blocks and the comments before them mean is said in `tests/docs_pieces.py`. Numbers, ids
and spaces of an output may differ, `…` stands for anything, an output line that is only `…` for
any number of lines; lines must come in their order. The pages of the effects are looked at by
`tests/unit/docs/test_docs_blocks.py`. The pages below `deploy/` install on a system as its root:
never here; `tests/debian` does their steps elsewhere.
"""

import contextlib

import pytest
from docs_pieces import COMMANDS, PAGES, ROOT, pieces
from docs_terminals import Session, missing_line

pytestmark = pytest.mark.system

FIRST = "docs/tutorials/first-run.md"
"""Its services do not watch their gap."""
SHARED = (("docs/tutorials/find-the-cause.md", "docs/how-to/diagnose.md"),)
"""Pages that are done one after the other in one directory."""
NIGHTLY = (pytest.mark.nightly, pytest.mark.timeout(600))
"""Marks of all pages; `make nightly` does them, `make test-docs` them alone."""


def has_something_to_do(name):
    page = (ROOT / name).read_text(encoding="utf-8")
    return any(
        piece.kind in (*COMMANDS, "python") and piece.order("skip") is None
        for piece in pieces(page)
    )


def journeys():
    """Pages to be done together: those that belong together, and every other one by itself."""
    together = {name for names in SHARED for name in names}
    pages = [str(page.relative_to(ROOT)) for page in PAGES if page.parent.name != "effects"]
    pages = [name for name in pages if not name.startswith("deploy/")]
    alone = [(name,) for name in pages if name not in together and has_something_to_do(name)]
    for names in (*SHARED, *alone):
        yield pytest.param(names, id=names[-1], marks=NIGHTLY)


@pytest.mark.parametrize("names", [*journeys()])
def test_a_page_does_what_it_says(names, tmp_path):
    with contextlib.ExitStack() as stack:
        session = Session(tmp_path, stack, watch=names != (FIRST,))
        for name in names:
            found = [*pieces((ROOT / name).read_text(encoding="utf-8"))]
            for piece in found:
                if piece.kind == "toml":  # a file may name one that is shown further down
                    session.write(piece)
            for piece in found:
                try:
                    session.do(piece)
                except AssertionError as error:
                    raise AssertionError(f"{name}, line {piece.line}: {error}") from None


def test_make_run_is_the_command_that_stands_in_for_it():
    run = (ROOT / "Makefile").read_text().split("\nrun:")[1].split("\n\n")[0]
    assert run.strip().endswith("orbitfb run --ioc sim")


def test_shown_lines_allow_other_numbers_and_nothing_else():
    assert missing_line(["state   CLOSED", "rms 0.2 µm"], "x\nstate CLOSED\nrms 14 µm") is None
    assert missing_line(["state   CLOSED"], "state HELD") == "state   CLOSED"
    assert missing_line(["b 1", "a 1"], "a 1\nb 2") == "a 1"
    assert missing_line(["policy svd-0123456789ab"], "policy svd-ba9876543210") is None
    assert missing_line(["reason …", "…", "end"], "reason any 3\nmore\nend") is None
