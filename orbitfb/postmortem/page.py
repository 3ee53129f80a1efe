"""A post-mortem as one file to look at: a page with its pictures inside, or a picture alone."""

import os
import warnings
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.html.figures import picture
from orbitfb.html.page import STYLE, paragraph, section, table, text
from orbitfb.postmortem.pictures import courses, orbits
from orbitfb.postmortem.story import Story, headline, lines

SUFFIXES = (".html", ".png", ".svg")
"""What can be written."""

_SIZE = (10.0, 9.5)


def write_page(story: Story, path: Path) -> None:
    """Write what a post-mortem looks like: the whole file or none.

    Args:
        story: What happened.
        path: Its suffix, one of `SUFFIXES`, says what is written.

    Raises:
        OrbitFeedbackError: It is another suffix, or the file cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise OrbitFeedbackError(f"{path}: name a file that ends in {', '.join(SUFFIXES)}")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            if path.suffix.lower() == ".html":
                part.write_text(page(story), encoding="utf-8")
            else:
                _picture(story, part, path.suffix.lower().removeprefix("."))
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise OrbitFeedbackError(
            f"the picture cannot be written to {path}: {error.strerror}; name another file with "
            "--out"
        ) from error


def page(story: Story) -> str:
    """Write the page; nothing in it can run or fetch, all text of the file is escaped."""
    its, found = story.its, story.analysis
    told = list(lines(story))
    facts = [line.partition(": ")[::2] for line in told[1:] if not line.startswith("  ")]
    changes = [(f"{change.since_trip:+.2f}", text(change.text)) for change in story.changes]
    pictures = ""
    if found is not None:
        pictures = picture(
            "Orbit error, every BPM, stored current, kicks and phases around the trip (dashed).",
            _SIZE,
            partial(courses, its=its, found=found),
        ) + picture(
            "Orbit error along the ring: as it was, when it began to leave, at the trip.",
            (10.0, 3.2),
            partial(orbits, its=its, found=found),
        )
    body = [
        f"<h1>{text(headline(its))}</h1>",
        paragraph(text(its.path.name), "source"),
        f'<div class="card" style="--badge: #a33a00"><p class="said">{text(its.reason)}</p></div>',
        table(
            ("what", "figures"),
            [(text(name), text(rest)) for name, rest in facts if rest and name != "reason"],
        ),
        section("courses", "Before and after", pictures),
        section("changes", "What changed", table(("s after the trip", "what"), changes)),
        section(
            "configuration",
            "Configuration",
            f"<details><summary>all of it</summary><pre>{text(its.configuration)}</pre></details>",
        ),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">"
        f"<title>Post-mortem: {text(headline(its))}</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(piece for piece in body if piece)
        + "\n</body></html>\n"
    )


def _picture(story: Story, path: Path, kind: str) -> None:
    figure = Figure(figsize=(_SIZE[0], _SIZE[1] + 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    if story.analysis is not None:
        parts: Any = figure.subfigures(2, 1, height_ratios=(_SIZE[1], 3.2))
        top, bottom = parts
        courses(top, story.its, story.analysis)
        orbits(bottom, story.its, story.analysis)
    figure.suptitle(f"{headline(story.its)}\n{_shown(story.its.reason)}", fontsize=10)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(path, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else {})


def _shown(words: str) -> str:
    """Make text for a picture: no formula, not too long."""
    plain = "".join(sign for sign in words if sign.isprintable())
    return plain[:150].replace("$", r"\$")
