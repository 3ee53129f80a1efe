"""The figures of judged answers, each with its interval."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.blind.judging import RECOGNISED, Judged
from orbitfb.estimation.priors import REMAINDER

BINS = 10
"""Of the reliability curve, each 0.1 of probability."""
_CONFIDENCE = 1.96
"""Standard deviations of a 95 % interval."""
_NINETY = 1.645
"""Of a 90 % interval."""
_SHRUNK, _MOST_OPEN = 0.9, 0.7
"""A shrink of 0.9 is wrong where the name is, or where less than 0.7 was there to be removed."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its interval (rates: 95 % Wilson, medians: 90 % bootstrap).

    Args:
        name: What it is of.
        value: NaN without a case.
        low: Lower end; NaN: no interval.
        high: Upper end.
        count: Cases.
        hits: Cases of a rate that count; None: no rate.
        wanted: What is to be reached, in words.
    """

    name: str
    value: float
    low: float
    high: float
    count: int
    hits: int | None = None
    wanted: str = ""


def wilson(hits: int, count: int, z: float = _CONFIDENCE) -> tuple[float, float]:
    """Interval of a rate (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if count == 0:
        return math.nan, math.nan
    share, weight = hits / count, z * z / count
    middle = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * math.sqrt(share * (1 - share) / count + weight / (4 * count))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def rate(name: str, hits: Iterable[bool], wanted: str = "") -> Figure:
    """Give a share of cases."""
    found = list(hits)
    low, high = wilson(sum(found), len(found))
    value = sum(found) / len(found) if found else math.nan
    return Figure(name, value, low, high, len(found), sum(found), wanted)


def median(name: str, values: Iterable[float], wanted: str = "") -> Figure:
    """Give a median with its bootstrap interval."""
    found = np.array([value for value in values if math.isfinite(value)])
    if not found.size:
        return Figure(name, math.nan, math.nan, math.nan, 0, wanted=wanted)
    draws = np.random.default_rng(0).choice(found, (2000, len(found)))
    low, high = np.percentile(np.median(draws, axis=1), [5, 95])
    return Figure(name, float(np.median(found)), float(low), float(high), len(found), wanted=wanted)


def _mean(name: str, values: Iterable[float], wanted: str = "") -> Figure:
    found = np.array([value for value in values if math.isfinite(value)])
    if not found.size:
        return Figure(name, math.nan, math.nan, math.nan, 0, wanted=wanted)
    draws = np.random.default_rng(0).choice(found, (2000, len(found))).mean(axis=1)
    low, high = np.percentile(draws, [5, 95])
    return Figure(name, float(found.mean()), float(low), float(high), len(found), wanted=wanted)


def _worst(name: str, values: Iterable[float], wanted: str = "") -> Figure:
    found = [value for value in values if math.isfinite(value)]
    return Figure(name, max(found, default=math.nan), math.nan, math.nan, len(found), wanted=wanted)


def calibration(judged: Sequence[Judged]) -> tuple[float, list[dict[str, Any]]]:
    """Hold the probability of the first name against how often it is right.

    Every answer with a name counts, those on records without a gap and of foreign effects, too.

    Returns:
        Expected calibration error, and the reliability curve: a row for every bin with a case.
    """
    given = [one for one in judged if one.named and math.isfinite(one.probability)]
    curve, error = [], 0.0
    for number in range(BINS):
        low, high = number / BINS, (number + 1) / BINS
        here = [
            one for one in given if low < one.probability <= high or low == one.probability == 0
        ]
        if here:
            told = sum(one.probability for one in here) / len(here)
            hits = sum(_name_right(one) for one in here)
            error += len(here) / len(given) * abs(told - hits / len(here))
            ends = wilson(hits, len(here))
            curve.append(
                {"from": low, "to": high, "told": told, "right": hits / len(here)}
                | {"low": ends[0], "high": ends[1], "count": len(here)}
            )
    return (error if given else math.nan), curve


def hidden(foreign: Sequence[Judged]) -> Figure:
    """Tell what an effect of no library leaves beside the one that it looks like, still hidden.

    If any share of it is alike, a rest R stays hidden beside E nats with the probability
    R / (E + R), as `orbitfb.diagnose.impact.named.listed_chance` has it.

    Args:
        foreign: Answers to effects of no library. Those that find nothing at all say nothing of
            it, nor do those that name a next of kin.

    Returns:
        The likeliest R, less its share of E, with its 90 % interval by likelihood [nats].
    """
    told = [
        (one.best, one.state not in RECOGNISED)
        for one in foreign
        if one.best > 0.0 and (one.state in RECOGNISED or (one.named and not one.right))
    ]
    name = "in no library: rest that stays hidden [nats]"
    if not told:
        return Figure(name, math.nan, math.nan, math.nan, 0)
    evidence, unseen = (np.array(values) for values in zip(*told, strict=True))
    rest = np.geomspace(1.0, 1e4, 401)
    chance = rest[:, None] + REMAINDER * evidence
    chance = chance / (evidence + chance)
    likely = np.where(unseen, np.log(chance), np.log1p(-chance)).sum(axis=1)
    within = rest[likely > likely.max() - 0.5 * _NINETY**2]
    best = float(rest[np.argmax(likely)])
    return Figure(name, best, float(within.min()), float(within.max()), len(told))


def _name_right(one: Judged) -> bool:
    """Whether the first name is right; saying "something else, too" makes no name right."""
    if one.truth.kind == "none":
        return False
    if one.truth.kind == "pair":
        return one.one
    return one.exact or (one.truth.kind == "single" and one.right)


def figures(judged: Sequence[Judged]) -> list[Figure]:
    """Give every figure of the table, in its order."""
    kinds = {
        kind: [j for j in judged if j.truth.kind == kind] for kind in ("none", "foreign", "pair")
    }
    single = [one for one in judged if one.truth.kind == "single"]
    seen = [one for one in single if one.truth.level in ("easy", "medium")]
    hard = [one for one in single if one.truth.level == "hard"]
    right = [one for one in single if one.right]
    shrunk = [one for one in right if (one.truth.shrink or 0.0) > 0.3]
    told = [one for one in judged if math.isfinite(one.shrink) and one.named]
    error, _ = calibration(judged)
    named = sum(one.named for one in judged)
    return [
        rate("right first or in class, easy and medium", (one.right for one in seen), "≥ 0.95"),
        rate("right first or in class, hard", (one.right for one in hard), "≥ 0.75"),
        rate("the very effect first", (one.exact for one in single)),
        rate("right among the best three", (one.top3 for one in single)),
        rate("effect called no gap, easy and medium", (one.state == "no_gap" for one in seen)),
        rate("effect called unknown, easy and medium", (one.state == "unknown" for one in seen)),
        rate("single effect confidently misnamed", (one.misnamed for one in single), "≤ 0.05"),
        _mean("probability on the right effect", (one.on_right for one in seen), "≥ 0.85"),
        Figure(
            "calibration error (ECE, 10 bins)", error, math.nan, math.nan, named, None, "≤ 0.05"
        ),
        median("devices, intersection over union", (one.devices for one in right), "≥ 0.95"),
        rate(
            "true value inside the 90 % interval",
            (bool(one.covered) for one in right if one.covered is not None),
            "0.85 … 0.95",
        ),
        median(
            "shrink over what knowing the effect removes (µm)",
            (_or_zero(one.shrink) / (one.truth.shrink or 1.0) for one in shrunk),
            "≥ 0.95",
        ),
        median("gain over that of knowing it, later record (nats)", (j.recovered for j in right)),
        rate("shrink ≥ 0.9 told and wrong", (_overtold(one) for one in told), "0"),
        rate("no gap: said so", (one.right for one in kinds["none"]), "≥ 0.95"),
        rate("no gap: a name given", (one.named for one in kinds["none"]), "0"),
        _worst(
            "no gap: evidence of the best effect, largest [nats]", (j.best for j in kinds["none"])
        ),
        rate(
            "in no library: recognised or next of kin",
            (one.right for one in kinds["foreign"]),
            "≥ 0.90",
        ),
        rate(
            "in no library: confidently misnamed", (j.misnamed for j in kinds["foreign"]), "≤ 0.05"
        ),
        hidden(kinds["foreign"]),
        rate("pairs, both", (one.right for one in kinds["pair"]), "≥ 0.63"),
        rate("pairs, at least one", (one.one for one in kinds["pair"]), "1"),
        rate("no answer", (one.state == "crash" for one in judged), "0"),
        median("seconds per record", (one.seconds for one in judged)),
        _worst("seconds, worst", (one.seconds for one in judged)),
        median("processor seconds per record", (one.cpu for one in judged), "≤ 5"),
        _worst("processor seconds, worst", (one.cpu for one in judged), "≤ 15"),
        _worst("memory of a process, largest [MB]", (one.peak_mb for one in judged)),
    ]


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _overtold(one: Judged) -> bool:
    open_ = one.truth.shrink is not None and one.truth.shrink < _MOST_OPEN
    return one.shrink >= _SHRUNK and (open_ or not _name_right(one))


def confusion(judged: Sequence[Judged]) -> dict[str, Counter[str]]:
    """Count what every kind of record was called; an answer without a name by its state."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for one in judged:
        name = " + ".join(sorted(one.names)) if one.named and one.names else f"({one.state})"
        table[one.truth.title][name] += 1
    return dict(sorted(table.items()))


def states(judged: Sequence[Judged]) -> dict[str, dict[str, tuple[int, int]]]:
    """Count answers by what the record is and their state: right ones, and all."""
    table: dict[str, dict[str, tuple[int, int]]] = {}
    for kind in ("none", "single", "foreign", "pair"):
        here = [one for one in judged if one.truth.kind == kind]
        table[kind] = {
            state: (sum(j.right for j in here if j.state == state), count)
            for state, count in Counter(one.state for one in here).most_common()
        }
    return table
