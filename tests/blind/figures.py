"""The figures of a set of judged answers, each with its interval."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.blind.classes import same_class
from tests.blind.judging import NAMES, Judged

DETECTABLE, CLEAR = 6.0, 12.0
"""d' from which an effect counts as detectable, and as clearly so."""


@dataclass(frozen=True)
class Figure:
    """A figure with its 90 % (rates: 95 % Wilson) interval, and how many cases it is of."""

    name: str
    value: float
    low: float
    high: float
    count: int
    wanted: str = ""


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a rate (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if count == 0:
        return float("nan"), float("nan")
    share, weight = hits / count, z * z / count
    middle = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * np.sqrt(share * (1 - share) / count + weight / (4 * count))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def rate(name: str, hits: Iterable[bool], wanted: str = "") -> Figure:
    """A share of cases."""
    found = list(hits)
    low, high = wilson(sum(found), len(found))
    value = sum(found) / len(found) if found else float("nan")
    return Figure(name, value, low, high, len(found), wanted)


def median(name: str, values: Iterable[float], wanted: str = "") -> Figure:
    """A median with its bootstrap interval (90 %)."""
    found = np.array([v for v in values if np.isfinite(v)])
    if not found.size:
        return Figure(name, float("nan"), float("nan"), float("nan"), 0, wanted)
    draws = np.random.default_rng(0).choice(found, (2000, len(found)))
    low, high = np.percentile(np.median(draws, axis=1), [5, 95])
    return Figure(name, float(np.median(found)), float(low), float(high), len(found), wanted)


def calibration(judged: Sequence[Judged], bins: int = 10) -> tuple[float, list[dict[str, Any]]]:
    """Expected calibration error of the probability of a name, and the reliability table."""
    given = [j for j in judged if j.named and np.isfinite(j.probability)]
    table, error = [], 0.0
    for number in range(bins):
        low, high = number / bins, (number + 1) / bins
        here = [
            j for j in given if low < j.probability <= high or (not number and not j.probability)
        ]
        if here:
            told = float(np.mean([j.probability for j in here]))
            true = float(np.mean([j.right for j in here]))
            error += len(here) / len(given) * abs(told - true)
            table.append({"from": low, "to": high, "told": told, "right": true, "count": len(here)})
    return (error if given else float("nan")), table


def figures(judged: Sequence[Judged]) -> list[Figure]:
    """Every figure of the table, in its order."""
    one = [j for j in judged if j.single and j.known]
    seen = [j for j in one if j.d_prime >= DETECTABLE]
    weak = [j for j in one if j.d_prime < DETECTABLE]
    passive = [j for j in seen if not j.dithered]
    dithered = [j for j in seen if j.dithered]
    right = [j for j in seen if j.right]
    nothing = [j for j in judged if not j.truth["effects"]]
    invented = [j for j in judged if j.single and not j.known]
    plain = [j for j in invented if j.d_prime >= CLEAR]
    pairs = [j for j in judged if len(j.truth["effects"]) == 2]
    error, _ = calibration([j for j in judged if len(j.truth["effects"]) == 1])
    told = sum(j.named for j in judged)
    return [
        rate("top-1, detectable, passive", (j.right for j in passive), "≥ 0.90"),
        rate("top-1, detectable, dithered", (j.right for j in dithered), "≥ 0.95"),
        rate("top-1, detectable, the very effect", (j.exact for j in seen)),
        rate("top-1, d' ≥ 12", (j.right for j in seen if j.d_prime >= CLEAR)),
        rate("top-3, detectable", (j.top3 for j in seen), "≥ 0.97"),
        rate("top-1, weak (d' < 6)", (j.right for j in weak)),
        rate(
            "right devices, given the right effect",
            (bool(j.place) for j in right if j.place is not None),
            "≥ 0.95",
        ),
        rate(
            "parameter inside its 90 % interval",
            (bool(j.covered) for j in right if j.covered is not None),
            "0.85 … 0.95",
        ),
        median("share of the oracle's held-out gain", (j.recovered for j in right), "≥ 0.97"),
        median("share of the oracle's gain, in the record itself", (j.fitted for j in right)),
        median(
            "shrink of the gap in µm, later record", (j.shrink_um for j in one if j.named), "≥ 0.90"
        ),
        rate(
            "a name on a record without a gap",
            (j.named or j.state == "crash" for j in nothing),
            "≤ 0.01",
        ),
        rate("any alarm on a record without a gap", (j.state != "no_gap" for j in nothing)),
        rate("invented effect confidently misnamed", (_misnamed(j) for j in invented), "≤ 0.05"),
        rate("invented effect recognised, d' ≥ 12", (_recognised(j) for j in plain), "≥ 0.90"),
        rate(
            "invented effect: right stage, d' ≥ 12",
            (j.stage == j.truth["effects"][0]["stage"] for j in plain),
        ),
        rate(
            "known effect called unknown, detectable",
            (j.state == "unknown" for j in seen),
        ),
        Figure("calibration error (ECE, 10 bins)", error, np.nan, np.nan, told, "≤ 0.05"),
        rate("pairs, exact set", (j.pair for j in pairs), "≥ 0.75"),
        median("size of the declared class", (float(j.size) for j in seen if j.size)),
        rate("no answer (crash)", (j.state == "crash" for j in judged)),
        median("seconds per record", (j.seconds for j in judged)),
    ]


def left_out(judged: Sequence[Judged]) -> list[Figure]:
    """Figures of answers of a library that lacks the true effect."""
    one = [j for j in judged if j.single and j.known and j.d_prime >= DETECTABLE]
    clear = [j for j in one if j.d_prime >= CLEAR]
    return [
        rate("left-out effect confidently misnamed", (_misnamed(j) for j in one), "≤ 0.05"),
        rate("left-out effect recognised, d' ≥ 12", (_recognised(j) for j in clear), "≥ 0.90"),
        rate(
            "left-out effect recognised, or named as of its class, d' ≥ 12",
            (_recognised(j) or _kin(j) for j in clear),
        ),
        rate(
            "left-out effect: right stage, d' ≥ 12",
            (j.stage == j.truth["effects"][0]["stage"] for j in clear),
        ),
    ]


def _misnamed(judged: Judged) -> bool:
    """A confident name without reserve (or no answer); one of its own class is no wrong one."""
    if judged.state == "crash":
        return True
    sure = judged.state == "named" and not judged.probability < 0.9
    return sure and not _kin(judged)


def _kin(judged: Judged) -> bool:
    true = judged.truth["effects"][0]["effect"]
    return any(same_class(name, true) for name in judged.effects[:1])


def _recognised(judged: Judged) -> bool:
    return judged.state in ("unknown", "named_plus_remainder")


def confusion(judged: Sequence[Judged]) -> dict[str, Counter[str]]:
    """What every true kind was called, detectable single cases and those without a gap."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for one in judged:
        if one.truth["effects"] and (not one.single or one.d_prime < DETECTABLE):
            continue
        name = one.effects[0] if one.state in NAMES and one.effects else f"({one.state})"
        table[one.kind][name] += 1
    return dict(sorted(table.items()))
