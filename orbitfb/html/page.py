"""Pieces of the page; every text that a record may have brought goes through `text`."""

from collections.abc import Iterable, Sequence
from html import escape

STYLE = """
:root { color-scheme: light dark; --ink: #1d2329; --soft: #5b6670; --line: #d4d9de;
  --fill: #f4f6f8; --paper: #fff; --link: #0072b2; --good: #00724f; --blue: #0072b2;
  --doubt: #805600; --odd: #8a3d6f; --bad: #a33a00 }
@media (prefers-color-scheme: dark) { :root { --ink: #e3e7ea; --soft: #a3adb5; --line: #3a434a;
  --fill: #20272c; --paper: #15191c; --link: #6cb8ea; --good: #3fb58b; --blue: #5aaee6;
  --doubt: #d9a43b; --odd: #d38ab9; --bad: #ef8a55 }
  figure img { filter: invert(.88) hue-rotate(180deg) } }
* { box-sizing: border-box }
body { font: 15px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 72rem;
  padding: 1.5rem 1.25rem 4rem; color: var(--ink); background: var(--paper) }
h1 { font-size: 1.5rem; margin: 0 0 .2rem } h2 { font-size: 1.2rem; margin: 2.4rem 0 .4rem;
  padding-top: .6rem; border-top: 1px solid var(--line) } h3 { font-size: 1rem; margin: 1.2rem 0 0 }
p { margin: .5rem 0; max-width: 60rem; overflow-wrap: break-word }
nav { display: flex; flex-wrap: wrap; gap: 0 1rem; margin: 1rem 0; font-size: .9rem }
nav a { color: var(--link); white-space: nowrap }
.source, .note, figcaption { color: var(--soft); font-size: .88rem }
.card { border: 1px solid var(--line); border-left: .5rem solid var(--badge, var(--soft));
  border-radius: .4rem; padding: 1rem 1.2rem; margin: 1rem 0; background: var(--fill) }
.card .said { font-size: 1.15rem; margin: .4rem 0 0; max-width: none }
.badge { display: inline-block; background: var(--badge, var(--soft)); color: var(--paper);
  font-weight: 600; border-radius: .25rem; padding: .05rem .55rem }
.tiles { display: flex; flex-wrap: wrap; gap: .7rem; margin: 1rem 0 }
.tile { border: 1px solid var(--line); border-radius: .4rem; padding: .5rem .8rem;
  flex: 1 1 9.5rem }
.tile b { display: block; font-size: 1.05rem; font-variant-numeric: tabular-nums }
.tile span { color: var(--soft); font-size: .85rem }
.wide { overflow-x: auto } table { border-collapse: collapse; margin: .6rem 0;
  font-variant-numeric: tabular-nums; font-size: .92rem }
th, td { border-bottom: 1px solid var(--line); padding: .25rem .7rem .25rem 0; text-align: left;
  vertical-align: top } .sentence { min-width: 16rem } th { color: var(--soft); font-weight: 600 }
.missing { color: var(--soft); border: 1px dashed var(--line); padding: .4rem .7rem;
  border-radius: .3rem; font-style: italic }
.finding { border-left: .25rem solid var(--badge, var(--soft)); padding-left: .7rem }
.finding b { color: var(--badge, var(--soft)) }
figure { margin: .8rem 0; overflow-x: auto }
figure img { max-width: 100%; min-width: 34rem; height: auto; display: block }
figure svg { width: 100%; max-width: 50rem; min-width: 34rem; height: auto; display: block;
  font: 12px system-ui, sans-serif }
details { margin: .6rem 0 } summary { cursor: pointer; color: var(--link) }
.flag { font-weight: 700; color: var(--bad) } code { overflow-wrap: anywhere; font-size: .88em }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0 } nav { display: none }
  figure img, figure svg { min-width: 0 }
  figure, table, .card, .tile, h2, h3 { break-inside: avoid } h2, h3 { break-after: avoid }
  .card, .badge { print-color-adjust: exact; -webkit-print-color-adjust: exact } }
"""


def text(value: str) -> str:
    """Write any text so that it is nothing but text; control characters are left out."""
    return escape("".join(sign for sign in value if sign.isprintable() or sign in " \n"))


def figure_of(value: float | None, digits: int = 3) -> str:
    """Write a number, or that it is not resolved."""
    return "not resolved" if value is None else f"{value:.{digits}g}"


def listed(names: Sequence[str], most: int = 12) -> str:
    """Write names in a row; not more than some."""
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return text(", ".join(names[:most])) + rest


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table; the cells are HTML already."""
    head = "".join(f"<th>{cell}</th>" for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def sentence(content: str) -> str:
    """Write a cell of a table that stays wide enough for a sentence, on any screen."""
    return f'<div class="sentence">{text(content)}</div>'


def paragraph(content: str, kind: str = "") -> str:
    """Write a paragraph of HTML; nothing when there is none."""
    if not content:
        return ""
    return f'<p class="{kind}">{content}</p>' if kind else f"<p>{content}</p>"


def folded(summary: str, content: str) -> str:
    """Write what few want to read so that it opens on a click."""
    return f"<details><summary>{text(summary)}</summary>{content}</details>"


def missing(what: str, why: str = "") -> str:
    """Say that something was not computed, and why, in the place of an empty picture."""
    reason = f" ({text(why)})" if why else ""
    return paragraph(f"{text(what)}: not computed for this record{reason}.", "missing")


def section(anchor: str, title: str, *pieces: str) -> str:
    """Write a section with its heading."""
    inner = "\n".join(piece for piece in pieces if piece)
    return f'<section id="{anchor}"><h2>{title}</h2>\n{inner}\n</section>'
