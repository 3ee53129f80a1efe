"""Names that somebody may have meant: one hint for commands, keys, effects, devices and PVs."""

import difflib
from collections.abc import Iterable
from itertools import takewhile

ALIKE = 0.6
"""Least likeness of a name that is offered, 0 to 1; difflib's own default."""


def near_names(name: str, known: Iterable[str], most: int = 3) -> list[str]:
    """Find the known names that are most like one, the likest first.

    Names of one family begin alike (`CH1A_C09`, `CH1A_C29`), and people mistype ends more than
    beginnings: so the likeness of the whole counts as much as that of the beginning. A name that
    the given one begins, or that contains it, is like it however much longer it is.

    Args:
        name: As it was typed.
        known: Those that there are.
        most: How many to give.
    """
    wanted = name.casefold()
    matcher = difflib.SequenceMatcher(b=wanted, autojunk=False)
    scored: list[tuple[float, str]] = []
    for each in dict.fromkeys(known):
        there = each.casefold()
        matcher.set_seq1(there)
        likeness = matcher.ratio()
        if wanted and wanted in there:
            likeness = max(likeness, ALIKE)
        if likeness >= ALIKE:
            alike = sum(1 for _ in takewhile(_same, zip(wanted, there, strict=False)))
            scored.append((likeness + alike / max(len(wanted), len(there)), each))
    return [each for _, each in sorted(scored, key=lambda pair: -pair[0])[:most]]


def did_you_mean(name: str, known: Iterable[str], most: int = 3) -> str:
    """Ask what was meant, as in ` (did you mean CH1A_C09 or CH1A_C29?)`: it follows the name.

    Args:
        name: As it was typed.
        known: Those that there are.
        most: How many to name.

    Returns:
        Empty where nothing is like it.
    """
    near = near_names(name, known, most)
    if not near:
        return ""
    *first, last = near
    return f" (did you mean {', '.join(first)} or {last}?)" if first else f" (did you mean {last}?)"


def _same(pair: tuple[str, str]) -> bool:
    return pair[0] == pair[1]
