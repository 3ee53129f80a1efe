"""What the screen proves is a cause, or a gap without a name, whatever the record shows besides."""

import pytest

from benchmarks.simulate import simulate_record
from orbitfb.diagnose.result.diagnosis import State
from orbitfb.diagnose.screen.rails import RAIL
from orbitfb.diagnose.screen.repeats import HELD
from orbitfb.diagnose.verdict.proved import Proved, Untold, proved
from orbitfb.diagnose.verdict.state import Judged, beside_proved
from orbitfb.diagnose.verdict.unknown import unknown_of
from orbitfb.physics.places import Ring
from orbitfb.records.finding import Finding
from orbitfb.records.record import Record

NAMES = ("PH1A_C03 (x)", "PH2A_C03 (x)")
HELD_ONES = Untold(NAMES, "Held.")


@pytest.fixture(scope="module")
def record() -> Record:
    return simulate_record(Ring.load(), ticks=50)


@pytest.mark.parametrize(
    ("otherwise", "state"),
    [
        ("no_gap", "unknown"),
        ("unknown", "unknown"),
        ("named", "named_plus_remainder"),
        ("ambiguous", "ambiguous"),
    ],
)
def test_what_is_proved_without_a_name_is_a_gap(
    record: Record, otherwise: State, state: State
) -> None:
    certain = Proved((), record, (HELD_ONES,))
    assert beside_proved(otherwise, certain) == state
    told = unknown_of(Judged(otherwise, (), 0.0), (), certain.untold)
    assert (told is None) == (state == "ambiguous")
    if told is not None:
        assert "Held." in told.text


def test_a_proved_cause_is_named_beside_what_is_found(record: Record) -> None:
    finding = Finding("repeated-orbit", "warning", (), None, "orbits repeat", "missed-read")
    certain = proved(record, [finding], frozenset())
    assert beside_proved("no_gap", certain) == "named"
    assert beside_proved("unknown", certain) == "named_plus_remainder"
    assert beside_proved("ambiguous", certain) == "ambiguous"


@pytest.mark.parametrize("check", [HELD, RAIL])
def test_what_was_held_or_clipped_is_left_out_of_the_record(record: Record, check: str) -> None:
    names = tuple(record.layout.bpms.label(column) for column in (3, 40))
    certain = proved(record, [Finding(check, "warning", names, None, "")], frozenset())
    (untold,) = certain.untold
    assert untold.devices == names
    assert names[0] in untold.text
    assert certain.causes == ()
    left = [certain.record.layout.bpms.label(i) for i in range(len(certain.record.layout.bpms))]
    assert len(left) == len(record.layout.bpms) - 2
    assert not set(names) & set(left)


@pytest.mark.parametrize("left_out", [False, True])
def test_what_is_proved_and_may_not_be_named_is_told_without_a_name(
    record: Record, left_out: bool
) -> None:
    finding = Finding("repeated-orbit", "warning", (), None, "orbits repeat", "missed-read")
    certain = proved(record, [finding], frozenset({"missed-read"} if left_out else ()))
    assert [cause.effect for cause in certain.causes] == ([] if left_out else ["missed-read"])
    assert [one.text for one in certain.untold] == (["Orbits repeat."] if left_out else [])
