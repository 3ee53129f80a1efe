"""The gap as a table: every number that the report draws, and nothing that could run."""

import csv
import io

import examples
import pytest

from orbitfb.diagnose.result.tables import HEADS, gap_csv


def lines(its):
    return list(csv.DictReader(io.StringIO(gap_csv(its))))


@pytest.fixture(scope="module")
def table():
    return lines(examples.named())


def test_every_part_of_the_gap_is_in_it(table):
    its = examples.named()
    for cut, parts in (("stage", its.gap.by_stage), ("bpm", its.gap.by_bpm)):
        own = {line["piece"]: float(line["value"]) for line in table if line["cut"] == cut}
        assert own == pytest.approx(dict(parts))
        assert all(line["adds_up"] == "yes" for line in table if line["cut"] == cut)
    bands = [line for line in table if line["cut"] == "band [Hz]"]
    assert [float(line["start"]) for line in bands] == [piece.start for piece in its.gap.by_band]
    assert bands[0]["resolved"] == "no"
    scores = [line for line in table if line["cut"] == "score, corrector-lag"]
    assert len(scores) == len(its.score_map.rows[0].gain)
    cells = [line for line in table if line["cut"] == its.maps[0].title]
    assert len(cells) == sum(len(row) for row in its.maps[0].values)


def test_devices_have_their_places(table):
    places = examples.named().geometry.bpms
    own = [line for line in table if line["cut"] == "bpm"]
    assert all(float(line["s_m"]) == places[line["piece"]] for line in own)


def test_a_name_is_no_formula():
    its = examples.named()
    hostile = its.gap.model_copy(update={"by_bpm": {"=HYPERLINK(1)": 1.0, "a\nb": 2.0}})
    names = [
        x["piece"] for x in lines(its.model_copy(update={"gap": hostile})) if x["cut"] == "bpm"
    ]
    assert names == ["'=HYPERLINK(1)", "ab"]


def test_without_a_gap_there_is_the_head():
    assert gap_csv(examples.bare()) == ",".join(HEADS) + "\n"
