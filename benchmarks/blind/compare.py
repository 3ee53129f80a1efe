"""Two engines on the same records: what one has right and the other wrong."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.blind.judging import Judged


@dataclass(frozen=True, slots=True)
class Paired:
    """A 2 × 2 table of paired outcomes with its exact test.

    Args:
        name: Which outcome.
        both: Records where both have it.
        first: Where the first alone has it.
        second: Where the second alone has it.
        neither: Where none has it.
    """

    name: str
    both: int
    first: int
    second: int
    neither: int

    @property
    def p_value(self) -> float:
        """Two-sided exact test of Q. McNemar, Psychometrika 12 (1947) 153.

        Of the records on which they differ, each is as likely to be the first one's as the second
        one's when none is better: the probability of a split at least as uneven as this.
        """
        differing, fewer = self.first + self.second, min(self.first, self.second)
        tail = sum(math.comb(differing, k) for k in range(fewer + 1)) / 2.0**differing
        return min(1.0, 2.0 * tail)

    def line(self) -> dict[str, Any]:
        """Tell it as the results have it."""
        counts = {name: getattr(self, name) for name in ("both", "first", "second", "neither")}
        return {"name": self.name, **counts, "p_value": self.p_value}


_Outcome = Callable[[Mapping[str, Any]], bool]


def rows(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Write judged answers as the results keep them, a row for every record."""
    kept = []
    for one in judged:
        values = {
            "record": one.key,
            "kind": one.truth.kind,
            "level": one.truth.level,
            "true": one.truth.title,
            "state": one.state,
            "names": list(one.names),
            "probability": one.probability,
            "right": one.right,
            "exact": one.exact,
            "top3": one.top3,
            "one": one.one,
            "misnamed": one.misnamed,
            "on_right": one.on_right,
            "devices": one.devices,
            "covered": one.covered,
            "shrink": one.shrink,
            "oracle_shrink": one.truth.shrink,
            "recovered": one.recovered,
            "best": one.best,
            "seconds": one.seconds,
            "cpu": one.cpu,
            "peak_mb": one.peak_mb,
            "problem": one.problem,
        }
        kept.append({name: finite(value) for name, value in values.items()})
    return kept


def finite(value: Any) -> Any:
    """Give a value as JSON can hold it: None in place of what is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def compare(
    first: Sequence[Mapping[str, Any]], second: Sequence[Mapping[str, Any]]
) -> list[Paired]:
    """Pair two engines' rows record by record; what only one was asked is left out."""
    theirs = {row["record"]: row for row in second}
    pairs = [(row, theirs[row["record"]]) for row in first if row["record"] in theirs]
    seen = [two for two in pairs if two[0]["kind"] == "single" and two[0]["level"] != "hard"]
    outcomes: list[tuple[str, list[Any], _Outcome]] = [
        ("right, all records", pairs, lambda row: row["right"]),
        ("right, single effects, easy and medium", seen, lambda row: row["right"]),
        (
            "right, no gap",
            [two for two in pairs if two[0]["kind"] == "none"],
            lambda row: row["right"],
        ),
        ("a wrong name", pairs, wrong_name),
        ("confidently misnamed", pairs, lambda row: row["misnamed"]),
    ]
    return [_paired(name, chosen, outcome) for name, chosen, outcome in outcomes]


def wrong_name(row: Mapping[str, Any]) -> bool:
    """Tell whether a name was given that the record does not have."""
    return bool(row["names"]) and not (row["right"] or row["one"])


def _paired(
    name: str, pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], outcome: _Outcome
) -> Paired:
    told = [(bool(outcome(a)), bool(outcome(b))) for a, b in pairs]
    counts = [
        told.count(two) for two in ((True, True), (True, False), (False, True), (False, False))
    ]
    return Paired(name, *counts)
