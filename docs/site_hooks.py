"""Hooks of mkdocs: the order of the sections, and links that lead out of `docs/`.

There is no list of pages: a page is on the site because it lies in a section's directory. A
directory that is no section is refused, so that no page is filed where nobody looks.
"""

import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

DOCS = Path(__file__).parent
SECTIONS = {
    "tutorials": "Tutorials",
    "how-to": "How to",
    "runbooks": "Runbooks",
    "explanations": "Explanations",
    "reference": "Reference",
}
"""Directory of a section -> its title, in the order of the menu."""
TUTORIALS = ("first-run", "your-ring", "find-the-cause", "measured-response")
"""The order in which a newcomer reads them."""
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")
ELSEWHERE = re.compile(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>")
CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Add the changelog, which lies beside `docs/`."""
    text = (DOCS.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    text = text.replace("](docs/", "](")
    files.append(File.generated(config, "changelog.md", content=text))
    return files


def on_nav(nav: Any, config: Any, files: Files) -> Any:
    """Sort the sections, and the tutorials in theirs."""
    titles = {name.replace("-", " ").capitalize(): name for name in SECTIONS}
    places = {name: place for place, name in enumerate(SECTIONS)}
    sections = [item for item in nav.items if item.is_section]
    unknown = [item.title for item in sections if item.title not in titles]
    if unknown:
        raise PluginError(
            f"directories of docs/ that are no section (docs/site_hooks.py): {unknown}"
        )
    pages = [item for item in nav.items if not item.is_section]
    sections.sort(key=lambda item: places[titles[item.title]])
    for section in sections:
        name = titles[section.title]
        section.title = SECTIONS[name]
        if name == "tutorials":
            section.children.sort(key=lambda page: TUTORIALS.index(Path(page.file.src_uri).stem))
    front = [page for page in pages if page.is_homepage]
    nav.items[:] = [*front, *sections, *(page for page in pages if page not in front)]
    return nav


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Make of a link to a file of the repository its path; the file must be there."""
    here = (DOCS / page.file.src_uri).parent

    def inside(found: re.Match[str]) -> str:
        mark, text, target, anchor = found[1], found[2], found[3], found[4] or ""
        path = (here / target).resolve()
        if re.match(r"[a-z]+:", target) or path.is_relative_to(DOCS):
            return found[0]
        if path == DOCS.parent / "CHANGELOG.md":
            up = "../" * page.file.src_uri.count("/")
            return f"{mark}[{text}]({up}changelog.md{anchor})"
        if not path.exists() or not path.is_relative_to(DOCS.parent):
            raise PluginError(f"{page.file.src_uri} links to {target}, which is not there")
        return f"{text} (`{path.relative_to(DOCS.parent)}`)"

    parts = CODE.split(markdown)
    return "".join(part if at % 2 else LINK.sub(inside, part) for at, part in enumerate(parts))


def on_post_build(config: Any) -> None:
    """Refuse a site that would load something from another computer."""
    for page in Path(config.site_dir).rglob("*.html"):
        for tag in ELSEWHERE.findall(page.read_text(encoding="utf-8")):
            raise PluginError(f"{page.name} loads from another computer: {tag}")
