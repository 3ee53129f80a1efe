"""Every relative link of the docs leads somewhere, anchors included; no page is left out."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md"]
PAGES += [ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"]
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
SOURCE = re.compile(r"`((?:[\w-]+/)+[\w-]+\.py)`(?:, `([a-z_]+)`(?: and `([a-z_]+)`)?)?")
"""A file of the code, and what is pointed to in it."""


def without_code(text):
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def links(page):
    for target in LINK.findall(without_code(page.read_text(encoding="utf-8"))):
        if not re.match(r"[a-z]+:", target):
            yield target


def anchors(page):
    """Anchors as GitHub and Python-Markdown make them of plain headings."""
    for heading in re.findall(r"^#+ (.*)$", without_code(page.read_text("utf-8")), re.MULTILINE):
        yield re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_resolve(page):
    for target in links(page):
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f"{page.relative_to(ROOT)} links to {target}, which is not there"
        assert ROOT in there.parents, f"{target} leads out of the repository"
        if anchor and there.suffix == ".md":
            assert anchor in anchors(there), f"{target}: no such heading"


def test_files_of_the_code_and_what_is_named_in_them_are_there():
    named = [found.groups() for page in PAGES for found in SOURCE.finditer(page.read_text("utf-8"))]
    assert len(named) > 50
    for path, *names in named:
        there = [root / path for root in (ROOT, ROOT / "orbitfb") if (root / path).is_file()]
        assert there, f"{path} is named and is not there"
        for name in filter(None, names):
            defined = re.search(rf"^ *(def|class) {name}\b", there[0].read_text(), re.MULTILINE)
            assert defined, f"{path} has no {name}"


def test_every_page_is_reached_from_the_index():
    seen, left = set(), [ROOT / "docs/index.md"]
    while left:
        page = left.pop()
        if page in seen or page.suffix != ".md":
            continue
        seen.add(page)
        targets = (target.partition("#")[0] for target in links(page))
        left += [(page.parent / target).resolve() for target in targets if target]
    missing = set((ROOT / "docs").rglob("*.md")) - seen
    assert not missing, f"not reached from docs/index.md: {sorted(map(str, missing))}"
