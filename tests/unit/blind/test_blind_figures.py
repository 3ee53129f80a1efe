"""Rates, curves and comparisons against numbers counted by hand or of tables."""

from typing import Any

import numpy as np
import pytest

from benchmarks.blind.compare import Paired, compare
from benchmarks.blind.figures import (
    calibration,
    confusion,
    figures,
    hidden,
    median,
    rate,
    states,
    wilson,
)
from benchmarks.blind.judging import judge
from benchmarks.blind.truth import TrueEffect, Truth
from orbitfb.estimation.priors import REMAINDER

GAIN = Truth((TrueEffect("bpm-gain", frozenset({"bpm-gain"})),), "easy")
NOTHING = Truth((), "none")


def named(truth: Truth, effect: str, chance: float = 0.95):
    causes = [{"effect": effect, "probability": chance}]
    return judge(truth, {"state": "named", "causes": causes})


def test_wilson_is_that_of_the_textbook() -> None:
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert rate("x", [True, False]).hits == 1
    assert rate("x", []).count == 0


def test_a_median_leaves_out_what_is_not_told() -> None:
    found = median("x", [1.0, float("nan"), 3.0, 2.0])
    assert (found.value, found.count) == (2.0, 3)


def test_calibration_error_is_that_of_a_hand_count() -> None:
    cases = [
        named(GAIN, "bpm-gain", 0.95),
        named(GAIN, "bpm-roll", 0.95),
        named(GAIN, "bpm-gain", 0.75),
        named(NOTHING, "bpm-gain", 0.75),
        judge(NOTHING, {"state": "no_gap"}),
    ]
    error, curve = calibration(cases)
    assert error == pytest.approx(0.5 * 0.45 + 0.5 * 0.25)
    assert [(row["right"], row["count"]) for row in curve] == [(0.5, 2), (0.5, 2)]


def test_the_largest_evidence_where_there_is_nothing_is_told() -> None:
    def quiet(truth: Truth, *nats: float):
        return judge(
            truth, {"state": "no_gap", "tournament": {"rows": [{"nats": n} for n in nats]}}
        )

    told = figures([quiet(NOTHING, -1.0, 4.5), quiet(NOTHING, 2.0), quiet(GAIN, 9.0)])
    found = next(one for one in told if one.name.startswith("no gap: evidence"))
    assert (found.value, found.count) == (4.5, 2)


def test_what_stays_hidden_of_effects_of_no_library_is_told() -> None:
    """Of draws whose rest is known; those that find nothing do not count."""
    rng, rest = np.random.default_rng(3), 60.0
    foreign = Truth((TrueEffect("odd", frozenset(), known=False),), "easy")

    def answer(evidence: float) -> dict[str, Any]:
        chance = (rest + REMAINDER * evidence) / (evidence + rest + REMAINDER * evidence)
        causes = [{"effect": "bpm-gain", "probability": 0.95}]
        state = "named" if rng.random() < chance else "unknown"
        return {"state": state, "causes": causes, "tournament": {"rows": [{"nats": evidence}]}}

    cases = [judge(foreign, answer(one)) for one in np.exp(rng.uniform(2.0, 8.0, 600))]
    found = hidden([*cases, judge(foreign, {"state": "no_gap", "causes": []})])
    assert found.count == 600
    assert found.low < rest < found.high < 1.6 * found.low
    assert hidden([]).count == 0


def test_confusion_and_states_count_every_record() -> None:
    cases = [named(GAIN, "bpm-roll"), named(GAIN, "bpm-gain"), judge(GAIN, {"state": "unknown"})]
    cases.append(judge(NOTHING, {"state": "no_gap"}))
    assert confusion(cases) == {
        "bpm-gain": {"bpm-roll": 1, "bpm-gain": 1, "(unknown)": 1},
        "no gap": {"(no_gap)": 1},
    }
    assert states(cases)["single"] == {"named": (1, 2), "unknown": (0, 1)}
    assert states(cases)["none"] == {"no_gap": (1, 1)}


@pytest.mark.parametrize(
    ("first", "second", "chance"),
    [(0, 0, 1.0), (5, 5, 1.0), (1, 0, 1.0), (6, 0, 0.03125), (9, 1, 0.021484375)],
)
def test_mcnemar_is_the_exact_binomial(first: int, second: int, chance: float) -> None:
    assert Paired("", 3, first, second, 4).p_value == pytest.approx(chance)
    assert Paired("", 3, second, first, 4).p_value == pytest.approx(chance)


def row(record: str, right: bool, names: tuple[str, ...] = ("bpm-gain",), kind: str = "single"):
    told = {"record": record, "kind": kind, "level": "easy", "right": right, "names": names}
    return told | {"one": False, "misnamed": not right}


def test_engines_are_paired_by_record() -> None:
    first = [row("a", True), row("b", False), row("c", True), row("d", False, ()), row("e", True)]
    second = [row("d", False), row("c", False), row("b", True), row("a", True), row("f", True)]
    right, *_, wrong, sure = compare(first, second)
    assert (right.both, right.first, right.second, right.neither) == (1, 1, 1, 1)
    assert (wrong.both, wrong.first, wrong.second, wrong.neither) == (0, 1, 2, 1)
    assert sure.neither == 1
