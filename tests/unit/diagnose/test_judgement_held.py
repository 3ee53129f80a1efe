"""BPMs of which not every reading was recorded leave a gap without a name."""

import pytest

from orbitfb.diagnose import judgement
from orbitfb.diagnose.certain import certain_causes
from orbitfb.diagnose.finding import Finding
from orbitfb.diagnose.integrity_repeats import HELD
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.physics.places import Ring

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
def test_what_was_held_is_no_gap_of_a_known_kind(otherwise, state):
    found = judgement.beside_held(otherwise, None, NAMES)
    assert found[0] == state
    assert (found[1] is None) == (state == "ambiguous")


def test_they_are_left_out_of_the_record():
    record = simulate_record(Ring.load(), ticks=50)
    names = tuple(record.layout.bpms.label(column) for column in (3, 40))
    finding = Finding(HELD, "warning", names, None, "")
    certain = certain_causes(record, [finding], frozenset())
    assert certain.held == names
    assert certain.causes == ()
    left = [certain.record.layout.bpms.label(i) for i in range(len(certain.record.layout.bpms))]
    assert len(left) == len(record.layout.bpms) - 2
    assert not set(names) & set(left)
