"""What the doctor finds: one line for each thing looked at, and what to do about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """How it stands with one thing."""

    OK = "ok"
    """As it should be."""
    SKIPPED = "skipped"
    """Not looked at; the line says why."""
    WARNING = "warning"
    """Works, but will not as it should."""
    FAILED = "failed"
    """`orbitfb run` would not work, or not on this ring."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Args:
        part: What it belongs to: program, configuration, files, clock, ports, environment, ring.
        check: What was looked at.
        verdict: How it stands.
        told: What was found, in a few words.
        advice: What to do; empty when there is nothing to do.
        figures: The same for programs, by name, units in the names.
    """

    part: str
    check: str
    verdict: Verdict
    told: str
    advice: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)


def as_text(findings: Sequence[Finding]) -> str:
    """Write findings for people: a table, and below it what to do."""
    check = max(len(each.check) for each in findings)
    verdict = max(len(each.verdict) for each in findings)
    lines: list[str] = []
    part = ""
    for each in findings:
        if each.part != part:
            part = each.part
            lines.append(f"{part}:")
        lines.append(f"  {each.verdict:<{verdict}}  {each.check:<{check}}  {each.told}".rstrip())
    advice = [f"  {each.check}: {each.advice}" for each in findings if each.advice]
    if advice:
        lines += ["", "what to do:", *advice]
    counts = {each: sum(f.verdict is each for f in findings) for each in Verdict}
    lines += ["", ", ".join(f"{count} {name}" for name, count in counts.items() if count)]
    return "\n".join(lines)


def as_answer(findings: Sequence[Finding]) -> dict[str, Any]:
    """Give findings as JSON knows them."""
    return {
        "schema": 1,
        "healthy": healthy(findings),
        "findings": [
            {
                "part": each.part,
                "check": each.check,
                "verdict": str(each.verdict),
                "told": each.told,
                "advice": each.advice,
                "figures": dict(each.figures),
            }
            for each in findings
        ],
    }


def healthy(findings: Sequence[Finding]) -> bool:
    """Tell whether nothing failed."""
    return all(each.verdict is not Verdict.FAILED for each in findings)
