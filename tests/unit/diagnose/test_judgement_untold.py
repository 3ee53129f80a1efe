"""What the screen proves and has no name is a gap, whatever the record shows besides."""

import pytest

from benchmarks.simulate import simulate_record
from orbitfb.diagnose import judgement
from orbitfb.diagnose.screen.repeats import HELD
from orbitfb.diagnose.verdict.proved import Untold, certain_causes
from orbitfb.physics.places import Ring
from orbitfb.records.finding import Finding

NAMES = ("PH1A_C03 (x)", "PH2A_C03 (x)")


@pytest.mark.parametrize(
    ("otherwise", "state"),
    [
        ("no_gap", "unknown"),
        ("unknown", "unknown"),
        ("named", "named_plus_remainder"),
        ("ambiguous", "ambiguous"),
    ],
)
def test_what_is_proved_is_no_gap_of_a_known_kind(otherwise, state):
    found = judgement.beside_untold(otherwise, None, [Untold("sensor", NAMES, "Held.")])
    assert found[0] == state
    assert (found[1] is None) == (state == "ambiguous")
    if found[1] is not None:
        assert found[1].stages == {"sensor": 1.0}
        assert found[1].places == NAMES


def test_what_was_held_is_left_out_of_the_record():
    record = simulate_record(Ring.load(), ticks=50)
    names = tuple(record.layout.bpms.label(column) for column in (3, 40))
    finding = Finding(HELD, "warning", names, None, "")
    certain = certain_causes(record, [finding], frozenset())
    (untold,) = certain.untold
    assert untold.devices == names
    assert names[0] in untold.text
    assert certain.causes == ()
    left = [certain.record.layout.bpms.label(i) for i in range(len(certain.record.layout.bpms))]
    assert len(left) == len(record.layout.bpms) - 2
    assert not set(names) & set(left)


@pytest.mark.parametrize("left_out", [False, True])
def test_what_is_proved_and_may_not_be_named_is_told_without_a_name(left_out):
    record = simulate_record(Ring.load(), ticks=50)
    finding = Finding("repeated-orbit", "warning", (), None, "orbits repeat", "missed-read")
    certain = certain_causes(record, [finding], frozenset({"missed-read"} if left_out else ()))
    assert [cause.effect for cause in certain.causes] == ([] if left_out else ["missed-read"])
    assert [its.stage for its in certain.untold] == (["timing"] if left_out else [])
