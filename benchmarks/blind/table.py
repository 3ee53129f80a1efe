"""The results for people: figures by source, states, reliability, confusion, comparison."""

import math
from collections.abc import Sequence
from typing import Any

from benchmarks.blind.compare import Paired, finite, rows, wrong_name
from benchmarks.blind.figures import Figure, calibration, confusion, figures, states
from benchmarks.blind.judging import Judged

_KINDS = {
    "none": "no gap",
    "single": "one effect",
    "foreign": "one effect of no library",
    "pair": "two effects",
}


def engine_text(engine: str, judged: Sequence[Judged]) -> str:
    """Write what one engine reached, as Markdown."""
    sources = list(dict.fromkeys(one.source for one in judged))
    columns = {"all": figures(judged)}
    if len(sources) > 1:
        columns |= {s: figures([one for one in judged if one.source == s]) for s in sources}
    lines = [
        f"## {engine}",
        "",
        f"{len(judged)} records. Rates with 95 % Wilson intervals, medians and means with 90 % "
        "bootstrap intervals, in brackets the number of records. No answer counts as wrong.",
        "",
        f"| figure | wanted | {' | '.join(columns)} |",
        f"|---|---|{'---|' * len(columns)}",
    ]
    for cells in zip(*columns.values(), strict=True):
        if any(cell.count for cell in cells):
            texts = " | ".join(map(_cell, cells))
            lines.append(f"| {cells[0].name} | {cells[0].wanted} | {texts} |")
    lines += ["", "### Answers by state (right of all)", "", "| record | state |", "|---|---|"]
    for kind, its in states(judged).items():
        if its:
            words = ", ".join(f"{state} {right} of {all_}" for state, (right, all_) in its.items())
            lines.append(f"| {_KINDS[kind]} | {words} |")
    _, curve = calibration(judged)
    lines += ["", "### Reliability of the probability of a name", ""]
    lines += ["| told | right | records |", "|---|---|---|"]
    for row in curve:
        ends = f"[{row['low']:.2f}, {row['high']:.2f}]"
        lines.append(f"| {row['told']:.2f} | {row['right']:.2f} {ends} | {row['count']} |")
    lines += ["", "### What was called what", "", "| true | called |", "|---|---|"]
    for true, called in confusion(judged).items():
        words = ", ".join(f"{name} {count}" for name, count in called.most_common())
        lines.append(f"| {true} | {words} |")
    return "\n".join([*lines, "", *_wrong(judged)])


def _wrong(judged: Sequence[Judged]) -> list[str]:
    """List the records that are not right, worst first: what to look at."""
    wrong = sorted(
        (one for one in judged if not one.right),
        key=lambda one: (not one.misnamed, not one.named, one.key),
    )
    lines = ["### Not right", "", "| record | level | true | answer |", "|---|---|---|---|"]
    for one in wrong:
        chance = f" ({one.probability:.2f})" if math.isfinite(one.probability) else ""
        answer = f"{one.state} {' + '.join(one.names)}{chance}"
        if one.problem:
            answer += f": {one.problem.strip().splitlines()[-1][:100]}"
        lines.append(f"| {one.key} | {one.truth.level} | {one.truth.title} | {answer} |")
    return [*lines, ""] if wrong else []


def figures_text(title: str, its: Sequence[Figure]) -> str:
    """Write figures by themselves, as Markdown."""
    lines = [f"## {title}", "", "| figure | wanted | found |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| {f.name} | {f.wanted} | {_cell(f)} |" for f in its), ""])


def paired_text(first: str, second: str, paired: Sequence[Paired]) -> str:
    """Write the comparison of two engines on the same records, as Markdown."""
    lines = [
        f"## {first} (A) beside {second} (B), the same records",
        "",
        "| outcome | both | A alone | B alone | neither | p (exact McNemar) |",
        "|---|---|---|---|---|---|",
    ]
    for one in paired:
        counts = f"{one.both} | {one.first} | {one.second} | {one.neither}"
        lines.append(f"| {one.name} | {counts} | {one.p_value:.3g} |")
    return "\n".join([*lines, ""])


def engine_document(judged: Sequence[Judged]) -> dict[str, Any]:
    """Give what one engine reached, as JSON holds it."""
    sources = list(dict.fromkeys(one.source for one in judged))
    groups = {"all": judged, **{s: [one for one in judged if one.source == s] for s in sources}}
    error, curve = calibration(judged)
    kept = rows(judged)
    return {
        "figures": {name: [_numbers(f) for f in figures(its)] for name, its in groups.items()},
        "calibration_error": finite(error),
        "reliability": curve,
        "states": states(judged),
        "confusion": {true: dict(called) for true, called in confusion(judged).items()},
        "wrong_names": sum(map(wrong_name, kept)),
        "records": kept,
    }


def _numbers(figure: Figure) -> dict[str, Any]:
    return {name: finite(getattr(figure, name)) for name in Figure.__dataclass_fields__}


def _cell(figure: Figure) -> str:
    if not math.isfinite(figure.value):
        return "–"
    ends = f" [{figure.low:.2f}, {figure.high:.2f}]" if math.isfinite(figure.low) else ""
    if figure.hits is not None:
        return f"{figure.value:.2f}{ends} ({figure.hits} of {figure.count})"
    return f"{figure.value:.3g}{ends} ({figure.count})"
