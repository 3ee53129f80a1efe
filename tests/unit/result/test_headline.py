"""The answer in an operator's words."""

import pytest

from orbitfb.diagnose.result.headline import headline
from orbitfb.diagnose.result.parts import Gap, PlaceValues
from orbitfb.diagnose.result.quantities import chance, interval, percent, quantity
from tests.unit.result import examples


def test_the_sentence_leads_with_cause_place_and_size_then_what_to_do_then_the_orbit():
    said = examples.named().headline
    wanted = (
        "Lag of a corrector on cells C04-C06: tau 93 [88, 98] ms",
        "from 112.4 s on",
        "probability 0.98",
        "Check the power supply and the magnet of cells C04-C06.",
        "adds 110 nm rms to the error of a prediction one row ahead; noise alone makes 310 nm",
        "removes 94 % [91, 97] of the added error on the later record",
        "holds the orbit to 349 nm rms; without the cause it would reach 336 nm",
    )
    places = [said.index(words) for words in wanted]
    assert places == sorted(places)
    assert "nats" not in said


def test_no_gap_is_said_with_the_noise_it_is_said_over():
    gap = Gap(nats_per_tick=0.0, low=0.0, high=0.0, um=0.0, floor_um=0.207)
    said = headline("no_gap", gap=gap)
    assert said.startswith("No gap")
    assert "207 nm" in said


def test_no_probability_is_a_certainty():
    assert chance(1.0) == chance(0.9999) == "above 0.99"
    assert chance(0.98) == "0.98"


@pytest.mark.parametrize(("probability", "weak"), [(0.85, True), (0.95, False), (None, False)])
def test_a_cause_of_weak_evidence_is_said_to_be_one(probability: float | None, weak: bool):
    cause = examples.lag_cause().model_copy(update={"probability": probability})
    assert ("no library may look like it" in headline("named", causes=(cause,))) is weak


def test_a_further_cause_that_is_hardly_one_is_left_to_the_table():
    first = examples.lag_cause()
    further = [
        first.model_copy(update={"probability": p, "label": f"C1{n}"})
        for n, p in enumerate((0.6, 5e-4))
    ]
    said = headline("named_plus_remainder", causes=(first, *further))
    assert "And: Lag of a corrector on C10" in said
    assert "C11" not in said


def test_errors_of_all_devices_are_refitted_not_repaired_one_by_one():
    everywhere = examples.lag_cause().model_copy(update={"scatter": True, "label": ""})
    said = headline("named", causes=(everywhere,))
    assert "rms over all of them" in said
    name = next(iter(everywhere.parameters))
    own = tuple(
        PlaceValues(places=(place,), values={name: value})
        for place, value in (("C01", 0.01), ("C02", -0.5), ("C03", 0.02))
    )
    told = everywhere.model_copy(update={"by_place": own})
    assert ", the largest -500 ms on C02" in headline("named", causes=(told,))
    assert "measure the response again, or refit" in said


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (3.44e-09, "m/s", "3.44 nm/s"),
        (0.0023, "A", "2.3 mA"),
        (-1.3e-6, "rad", "-1.3 µrad"),
        (0.0, "m", "0 µm"),
        (0.3, "1", "0.3"),
        (12.0, "Hz", "12 Hz"),
        (12345.0, "1/m", "12345 1/m"),
        (None, "m", "not resolved"),
    ],
)
def test_numbers_have_the_prefix_that_makes_them_readable(value, unit, words):
    assert quantity(value, unit) == words


def test_an_interval_has_one_prefix():
    assert interval(9.8e-4, 9.5e-4, 1.02e-3, "A") == "0.98 [0.95, 1.02] mA"


def test_not_all_is_gone_where_something_is_left():
    assert percent(0.996) == "99 %"
    assert percent(1.0) == "100 %"
