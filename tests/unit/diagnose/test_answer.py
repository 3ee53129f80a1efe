"""The answer of a diagnosis goes into a file and comes back, and its sentence says it."""

import json

import examples
import numpy as np
import pytest
from pydantic import ValidationError

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.result.blocks import HeatMap
from orbitfb.diagnose.result.diagnosis import Diagnosis, document, read_diagnosis, schema
from orbitfb.diagnose.result.headline import headline
from orbitfb.diagnose.result.parts import Gap, Shrink

MANY = ("named", "bare", "unknown", "broken")


@pytest.mark.parametrize("name", MANY)
def test_a_diagnosis_comes_back_from_its_file_as_it_was(tmp_path, name):
    its = getattr(examples, name)()
    (tmp_path / "diagnosis.json").write_text(document(its), encoding="utf-8")
    assert read_diagnosis(tmp_path / "diagnosis.json") == its


def test_what_is_not_finite_is_not_resolved():
    gap = Gap(
        nats_per_tick=np.float64("nan"),
        low=-np.inf,
        high=np.float32(2.0),
        um=1,
        floor_um=None,
        by_mode=np.array([1.0, np.nan]),
        by_bpm={"A": float("nan")},
    )
    grid = HeatMap(title="", row_label="", column_label="", values=np.array([[np.inf, 1.0]]))
    assert (gap.nats_per_tick, gap.low, gap.high, gap.floor_um) == (None, None, 2.0, None)
    assert gap.by_mode == (1.0, None)
    assert gap.by_bpm == {"A": None}
    assert grid.values == ((None, 1.0),)
    json.loads(document(examples.bare(gap=gap, maps=(grid,))), parse_constant=pytest.fail)


def test_no_diagnosis_can_be_changed_or_hold_what_nobody_knows():
    its = examples.bare()
    with pytest.raises(ValidationError):
        its.headline = "another"
    with pytest.raises(ValidationError):
        Diagnosis(**{**its.model_dump(), "guess": 1})


def test_the_keys_that_were_promised_are_in_the_document():
    content = json.loads(document(examples.named()))
    assert {"state", "causes", "gap", "shrink", "experiment", "not_tested", "detectable"} <= set(
        content
    )
    wanted = "effect stage places parameters probability onset_s alternatives"
    assert set(wanted.split()) <= set(content["causes"][0])
    assert {"value", "low", "high", "unit"} <= set(content["causes"][0]["parameters"]["tau"])
    wanted = "nats_per_tick um floor_um low high by_stage by_bpm by_corrector"
    assert set(wanted.split()) <= set(content["gap"])
    assert {"nats", "um", "low", "high", "held_out_ticks", "competitor_um"} <= set(
        content["shrink"]
    )


def test_the_schema_names_every_key_of_a_document():
    content = json.loads(schema())
    assert set(content["properties"]) == set(json.loads(document(examples.bare())))
    assert content["additionalProperties"] is False


@pytest.mark.parametrize("text", ["", "{}", '{"schema_version": "0.1"}', "[1"])
def test_a_file_that_is_no_diagnosis_is_refused_by_name(tmp_path, text):
    file = tmp_path / "diagnosis.json"
    file.write_text(text)
    with pytest.raises(RecordError, match=r"diagnosis\.json"):
        read_diagnosis(file)


def test_the_sentence_says_cause_place_size_probability_and_shrink():
    said = examples.named().headline
    for words in (
        "0.42 [0.39, 0.45] nats/tick",
        "lag of a corrector on cells C04-C06",
        "tau = 0.093 [0.088, 0.098] s",
        "from 112.4 s on",
        "P = 0.98",
        "shrinks by 96 % [94, 98]",
        "measured 0.349",
    ):
        assert words in said


def test_a_gap_that_stays_as_it_is_is_not_said_to_shrink_by_nothing():
    same = examples.named().shrink.model_copy(update={"nats": -1e-4, "low": -1e-3, "high": 0.0})
    said = headline("named", causes=(examples.lag_cause(),), shrink=same)
    assert "the gap stays as it is" in said
    assert "0 %" not in said


def test_a_gap_that_grows_is_said_to_grow():
    grown = Shrink(nats=-0.2, low=-0.3, high=-0.1, um=-0.1, held_out_ticks=100)
    said = headline("named", causes=(examples.lag_cause(),), shrink=grown)
    assert "the gap grows by 20 % [10, 30]" in said


def test_no_probability_is_rounded_up_to_certainty():
    cause = examples.lag_cause().model_copy(update={"probability": 1.0})
    assert "P = 0.999" in headline("named", causes=(cause,))


def test_a_further_cause_that_is_hardly_one_is_left_to_the_table():
    first = examples.lag_cause()
    further = [
        first.model_copy(update={"probability": p, "label": f"C1{n}"})
        for n, p in enumerate((0.6, 5e-4))
    ]
    said = headline("named_plus_remainder", causes=(first, *further))
    assert "And: lag of a corrector on C10" in said
    assert "C11" not in said


def test_an_unresolved_gap_is_said_to_be_unresolved():
    gap = Gap(nats_per_tick=0.01, low=-0.1, high=0.1, um=0.0, floor_um=0.3, resolved=False)
    assert "No gap is resolved" in headline("no_gap", gap=gap)
    said = headline("named", gap=gap, causes=(examples.lag_cause(),))
    assert said.startswith("Apart from what is named no gap is resolved")
