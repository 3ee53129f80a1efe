"""The scorer of sealed cases, on answers made by hand."""

import json
from pathlib import Path

import pytest

from orbitfb.physics.places import Ring
from tests.blind.figures import calibration, figures, left_out
from tests.blind.judging import Judged, Order, judge


@pytest.fixture(scope="module")
def orders() -> dict[str, Order]:
    return {"first": Order(Ring.load())}


def truth(effect: str | None, stage: str = "sensor", places: tuple[str, ...] = (), **more):
    effects = []
    if effect:
        values = {
            "effect": effect,
            "stage": stage,
            "known": not effect.startswith("x-"),
            "places": list(places),
            "parameters": {"gain": {"value": 0.05, "unit": "1"}},
            "d_prime": 20.0,
            "oracle_nats": 200.0,
        }
        effects.append(values | more)
    case = {"case": "c", "effects": effects, "ring": "first", "dither": "passive"}
    return case | {"later_oracle_nats": 400.0}


def cause(effect: str, places: tuple[str, ...] = (), probability: float = 0.97, **more):
    values = {"effect": effect, "stage": "sensor", "places": list(places)}
    return values | {"probability": probability, "alternatives": [], "parameters": {}} | more


def judged(asked, answer, tmp_path: Path, orders) -> Judged:
    if answer is not None:
        (tmp_path / "diagnosis.json").write_text(json.dumps(answer), encoding="utf-8")
    return judge(asked, tmp_path, orders)


def value(name: str, *cases: Judged) -> float:
    return next(f.value for f in (*figures(cases), *left_out(cases)) if f.name == name)


def test_a_right_answer(tmp_path: Path, orders) -> None:
    interval = {"gain": {"value": 0.049, "low": 0.04, "high": 0.06, "unit": "1"}}
    told = cause("bpm-gain", ("PH1A_C30",), parameters=interval, held_out_nats=190.0)
    shrink = {"um": 0.95, "on": "the later record", "held_out_ticks": 1000}
    shrink |= {"before_nats_per_tick": 0.45, "after_nats_per_tick": 0.05}
    answer = {"state": "named", "causes": [told], "shrink": shrink}
    found = judged(truth("bpm-gain", places=("PH1A_C30",)), answer, tmp_path, orders)
    assert (found.exact, found.right, found.place, found.covered) == (True, True, True, True)
    assert (found.recovered, found.fitted) == (pytest.approx(1.0), pytest.approx(0.95))
    assert value("top-1, detectable, passive", found) == 1.0


def test_a_class_by_declaration_or_construction_is_right_but_not_exact(
    tmp_path: Path, orders
) -> None:
    for told in (cause("bpm-nonlinearity"), cause("bpm-offset", alternatives=["bpm-gain"])):
        answer = {"state": "ambiguous", "causes": [told]}
        found = judged(truth("bpm-gain"), answer, tmp_path, orders)
        assert found.right
        assert not found.exact
    found = judged(
        truth("bpm-gain"), {"state": "named", "causes": [cause("bpm-roll")]}, tmp_path, orders
    )
    assert not found.right


@pytest.mark.parametrize(
    ("named", "good"), [("QH2A_C30", True), ("QH3A_C30", False), ("CH1A_C30", True)]
)
def test_a_neighbour_is_good_for_a_quadrupole(
    named: str, good: bool, tmp_path: Path, orders
) -> None:
    asked = truth("quadrupole-gradient", "optics", ("QH1A_C30",))
    answer = {"state": "named", "causes": [cause("quadrupole-gradient", (named,))]}
    assert judged(asked, answer, tmp_path, orders).place is good


def test_a_neighbour_is_not_good_for_a_bpm(tmp_path: Path, orders) -> None:
    answer = {"state": "named", "causes": [cause("bpm-gain", ("PH2A_C30",))]}
    assert judged(truth("bpm-gain", places=("PH1A_C30",)), answer, tmp_path, orders).place is False


def test_no_answer_is_wrong_everywhere(tmp_path: Path, orders) -> None:
    known, none, new = (
        judged(truth(name), None, tmp_path, orders) for name in ("bpm-gain", None, "x-new")
    )
    assert value("top-1, detectable, passive", known) == 0.0
    assert value("a name on a record without a gap", none) == 1.0
    assert value("invented effect confidently misnamed", new) == 1.0
    assert value("invented effect recognised, d' ≥ 12", new) == 0.0


def test_an_invented_effect_is_to_be_recognised(tmp_path: Path, orders) -> None:
    answer = {
        "state": "unknown",
        "causes": [],
        "unknown": {"stages": {"sensor": 0.8, "noise": 0.2}},
    }
    found = judged(truth("x-new"), answer, tmp_path, orders)
    assert value("invented effect recognised, d' ≥ 12", found) == 1.0
    assert value("invented effect: right stage, d' ≥ 12", found) == 1.0
    sure = judged(
        truth("x-new"), {"state": "named", "causes": [cause("bpm-gain")]}, tmp_path, orders
    )
    assert value("invented effect confidently misnamed", sure) == 1.0


def test_calibration_error_is_that_of_a_hand_count(tmp_path: Path, orders) -> None:
    cases = [
        judged(
            truth("bpm-gain"),
            {"state": "named", "causes": [cause(effect, probability=chance)]},
            tmp_path,
            orders,
        )
        for effect, chance in (("bpm-gain", 0.95), ("bpm-roll", 0.95), ("bpm-gain", 0.75))
    ]
    error, table = calibration(cases)
    assert error == pytest.approx(2 / 3 * 0.45 + 1 / 3 * 0.25)
    assert [row["count"] for row in table] == [1, 2]
