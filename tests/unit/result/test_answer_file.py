"""The answer of a diagnosis goes into a file and comes back."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.report.writing import EFFECTS, effects_of, write
from orbitfb.diagnose.result.diagnosis import Diagnosis, document, read_diagnosis, schema
from orbitfb.diagnose.result.parts import Gap, PlaceValues
from orbitfb.diagnose.result.schema_page import answer_page
from tests.unit.result import examples

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
    assert (gap.nats_per_tick, gap.low, gap.high, gap.floor_um) == (None, None, 2.0, None)
    assert gap.by_mode == (1.0, None)
    json.loads(document(examples.bare(gap=gap)), parse_constant=pytest.fail)


def test_no_diagnosis_can_be_changed_or_hold_what_nobody_knows():
    its = examples.bare()
    with pytest.raises(ValidationError):
        its.headline = "another"
    with pytest.raises(ValidationError):
        Diagnosis(**{**its.model_dump(), "guess": 1})


def test_the_schema_names_every_key_of_a_document():
    content = json.loads(schema())
    assert set(content["properties"]) == set(json.loads(document(examples.bare())))
    assert content["additionalProperties"] is False
    page = answer_page("")
    for name in content["properties"]:
        assert f"| `{name}` |" in page


@pytest.mark.parametrize("text", ["", "{}", '{"schema_version": "1.0"}', "[1"])
def test_a_file_that_is_no_diagnosis_is_refused_by_name(tmp_path, text):
    file = tmp_path / "diagnosis.json"
    file.write_text(text)
    with pytest.raises(RecordError, match=r"diagnosis\.json"):
        read_diagnosis(file)


def test_effects_have_the_values_of_every_device_where_they_differ():
    cause = examples.lag_cause()
    every = tuple(
        PlaceValues(places=(name,), planes="x", values={"tau": tau}, onset_s=onset)
        for name, tau, onset in (("COR06", 0.09, None), ("COR07", 0.03, 8.0))
    )
    same = effects_of([cause])
    assert [one.names for one in same] == [cause.places]
    own = effects_of([cause.model_copy(update={"by_place": every})])
    assert [(one.names, one.values["tau"]) for one in own] == [
        (("COR06",), 0.09), (("COR07",), 0.03),
    ]  # fmt: skip


def test_all_files_are_written_or_none(tmp_path):
    written = write(examples.named(), tmp_path / "out")
    assert {path.name for path in written} == {
        "diagnosis.json", "report.html", "gap.csv", EFFECTS,
    }  # fmt: skip
    assert all(path.stat().st_size for path in written)
