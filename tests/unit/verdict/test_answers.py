"""Answers to small records whose cause is known, from the record to the words."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind import many
from orbitfb.core.signals import Vector
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.headline import RING
from orbitfb.diagnose.result.parts import Shrink
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.diagnose.verdict.files import diagnose_files
from orbitfb.diagnose.verdict.state import Judged, beside_each_other, beside_left
from orbitfb.diagnose.verdict.unknown import unknown_of
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import NOISE, Bent, lagging, make_record


def answer(record: Record) -> Diagnosis:
    return diagnose(record, seed=0, progress=lambda what, share: None)


def last_row(bend: Bent) -> Bent:
    """A memoryless law of the currents of one row."""
    return lambda currents: bend(currents[-1:].copy())


def reversed_fourth(currents: Matrix) -> Matrix:
    currents[:, 4] *= -1.0
    return currents


LIMITS = np.linspace(0.025, 0.06, 8)


def clipped(currents: Matrix) -> Matrix:
    """Correctors 2 to 9 end at limits of their own."""
    currents[:, 2:10] = np.clip(currents[:, 2:10], -LIMITS, LIMITS)
    return currents


def creeping(currents: Matrix) -> Matrix:
    """Corrector 6 goes on by a third of what it moved three and four rows ago: in no library."""
    kicked = currents[-1:].copy()
    if len(currents) > 5:
        kicked[0, 6] += 0.8 * (currents[-4, 6] - currents[-5, 6])
    return kicked


CELL = [1, 2, 3, 4]


def leaking() -> Bent:
    """A fifth of the currents of a cell leaks away in nine rows and comes back: in no library."""
    held: list[Vector] = []

    def bent(currents: Matrix) -> Matrix:
        if len(currents) == 1:
            held[:] = [currents[0].copy(), currents[0].copy()]
        held[0] = held[0] + (currents[-1] - held[0]) * (1.0 - np.exp(-1.0 / 9.0))
        acting = currents[-1:].copy()
        acting[0, CELL] -= 0.2 * (held[0] - held[1])[CELL]
        return acting

    return bent


def rising(currents: Matrix) -> Matrix:
    """Correctors of a cell go too far where they rise, and only there: in no library."""
    acting = currents[-1:].copy()
    if len(currents) > 1:
        acting[0, CELL] += 0.3 * np.maximum(currents[-1] - currents[-2], 0.0)[CELL]
    return acting


def relaxing(currents: Matrix) -> Matrix:
    """A twentieth of every change comes back in three times that are far apart: in no library."""
    past = np.arange(len(currents))[::-1, None]
    fading = sum(np.exp(-past / rows) for rows in (5.0, 50.0, 500.0)) / 3.0
    changes = np.diff(currents, axis=0, prepend=currents[:1])
    return currents[-1:] - 0.05 * (fading * changes).sum(axis=0)


def wavering(currents: Matrix) -> Matrix:
    """Something beside corrector 5 swings at a frequency that changes: in no library."""
    rows = np.arange(len(currents))
    phase = np.cumsum(0.9 + 0.15 * np.sin(rows / 37.0) + 0.1 * np.sin(rows / 11.0))
    acting = currents[-1:].copy()
    acting[0, 5] += 8e-3 * np.sin(phase[-1])
    return acting


def slow(currents: Matrix) -> Matrix:
    """Three tenths of every change reach the field of all correctors late: in no library."""
    fading = np.exp(-np.arange(len(currents))[::-1] / 80.0)[:, None]
    changes = np.diff(currents, axis=0, prepend=currents[:1])
    return currents[-1:] - 0.3 * (fading * changes).sum(axis=0)


def stuck_late(currents: Matrix) -> Matrix:
    """Corrector 9 stays where it is from row 400 on."""
    kicked = currents[-1:].copy()
    if len(currents) > 400:
        kicked[0, 9] = currents[400, 9]
    return kicked


def cubic(orbit: Matrix) -> Matrix:
    """Every BPM reads the less, the further out the beam is."""
    return 4e-6 * np.tanh(orbit / 4e-6)


def louder_outside(seed: int) -> Bent:
    """The noise of every BPM is the louder, the further out the beam is: in no library."""
    rng = np.random.default_rng(seed)
    return lambda orbit: orbit + NOISE * np.abs(orbit) / 1e-6 * rng.standard_normal(orbit.shape)


def with_tails(seed: int) -> Bent:
    """One reading in twenty has five times the noise, wherever the beam is."""
    rng = np.random.default_rng(seed)
    return lambda orbit: (
        orbit + 5.0 * NOISE * rng.standard_normal(orbit.shape) * (rng.random(orbit.shape) < 0.05)
    )


def with_cell(record: Record) -> Record:
    """The same with correctors of two cells."""
    correctors = record.layout.correctors
    cells = tuple("A" if number in CELL else "B" for number in range(len(correctors)))
    layout = replace(record.layout, correctors=replace(correctors, cells=cells))
    return replace(record, layout=layout)


@pytest.mark.parametrize("seed", [21, pytest.param(22, marks=pytest.mark.nightly)])
def test_a_healthy_record_has_no_gap(seed: int) -> None:
    found = answer(make_record(seed))
    assert (found.state, found.causes) == ("no_gap", ())
    assert "No gap:" in found.headline
    assert found.experiment is None


@pytest.fixture(scope="module")
def told_reversed() -> Diagnosis:
    return answer(make_record(23, currents=last_row(reversed_fourth), gain=0.0))


def test_a_reversed_corrector_is_named_and_the_gap_is_gone(told_reversed: Diagnosis) -> None:
    found = told_reversed
    assert found.state in ("named", "ambiguous")  # a gain of -2 is the same fault in other words
    assert [one.effect for one in found.causes] == ["corrector-polarity"]
    assert found.causes[0].places == ("C4",)
    assert (found.causes[0].probability or 0.0) > 0.9
    assert found.shrink is not None
    assert (found.shrink.um or 0.0) > 0.9  # the floor of 900 rows is known to a twentieth


@pytest.mark.parametrize("seed", [24, 25])
def test_correctors_that_end_at_limits_of_their_own_are_one_cause_with_these_limits(
    seed: int,
) -> None:
    found = answer(make_record(seed, currents=last_row(clipped)))
    (cause,) = found.causes
    assert cause.effect == "corrector-saturation"
    told = {one.places[0]: one.values["limit"] for one in cause.by_place}
    assert told == {f"C{2 + i}": pytest.approx(m, rel=0.05) for i, m in enumerate(LIMITS)}


def test_a_lag_has_its_time_constant_in_the_interval() -> None:
    found = answer(make_record(25, currents=lagging(np.exp(-2.0))))
    first = found.causes[0]
    tau = first.parameters["tau"]
    assert "corrector-lag" in (first.effect, *first.alternatives)  # a BPM's average is like it
    assert tau.low is not None
    assert tau.high is not None
    assert tau.low < 0.05 < tau.high
    assert tau.high - tau.low < 0.02


def test_what_no_library_has_is_unknown_at_its_device() -> None:
    found = answer(make_record(26, currents=creeping))
    assert found.state in ("unknown", "named_plus_remainder")
    assert found.unknown is not None
    assert found.unknown.places[0] == "C6 (x)"


def test_what_the_devices_of_a_cell_do_alike_and_no_library_has_is_unknown() -> None:
    """Each of them alone shows too little."""
    found = answer(with_cell(make_record(26, currents=leaking())))
    assert (found.state, found.causes) == ("unknown", ())
    assert found.unknown is not None
    assert found.unknown.places == ("C1 (x)", "C2 (x)", "C3 (x)", "C4 (x)")
    assert "follows the motion of the correctors of A" in found.unknown.text


@pytest.mark.parametrize("seed", [26, 27])
def test_an_unknown_law_that_looks_like_one_of_the_library_is_unknown(seed: int) -> None:
    """A resonance of the cell would be named for it."""
    found = answer(with_cell(make_record(seed, currents=rising)))
    assert found.state == "unknown"
    assert found.unknown is not None
    assert found.unknown.places[:4] == ("C1 (x)", "C2 (x)", "C3 (x)", "C4 (x)")


def test_a_weak_law_of_all_devices_that_looks_like_one_of_the_library_is_unknown() -> None:
    """A hysteresis of all correctors has a share of it."""
    found = answer(make_record(26, currents=relaxing, gain=0.0))
    assert (found.state, found.causes) == ("unknown", ())


def test_a_place_that_kicks_by_a_course_of_no_library_is_unknown() -> None:
    """A wave of one frequency, the nearest in the library, has a fraction of it."""
    found = answer(make_record(26, currents=wavering))
    assert found.state == "unknown"
    assert found.unknown is not None
    assert found.unknown.places[0] == "C5 (x)"
    assert "The gap is like kicks at C5 (x)" in found.unknown.text


def test_what_all_devices_do_alike_and_no_library_has_is_unknown() -> None:
    """A gain of all correctors takes most of it; what is left looks like ground that goes on."""
    found = answer(make_record(24, currents=slow, gain=0.0))
    assert found.state == "unknown"
    assert found.unknown is not None
    assert "alike, by a law that is not in the library" in found.unknown.text


@pytest.mark.parametrize(("most", "state"), [(0.6, "named_plus_remainder"), (1.0, "named")])
def test_causes_that_leave_much_of_the_gap_are_not_all(most: float, state: str) -> None:
    """The quiet rows tell what the floor would have for noise."""
    shrunk = Shrink(nats=0.5, low=0.4, high=most, um=0.3, um_low=0.2, um_high=0.4,
                    held_out_ticks=100, on="the record itself")  # fmt: skip
    assert beside_left(Judged("named", (), 0.0), shrunk, True).state == state
    assert beside_left(Judged("no_gap", (), 0.0), shrunk, True).state == "no_gap"


@pytest.mark.nightly
def test_a_corrector_that_sticks_late_is_told_with_the_time() -> None:
    found = answer(make_record(27, currents=stuck_late, rows=700))
    first = found.causes[0]
    assert first.places == ("C9",)
    assert first.effect == "corrector-stuck" or "corrector-stuck" in first.alternatives
    assert first.onset_s == pytest.approx(40.0, abs=2.0)


@pytest.mark.parametrize("seed", [29, 31])
@pytest.mark.parametrize("before", [False, True])
def test_bpms_that_are_not_linear_are_one_cause_and_hardly_anything_is_left(
    before: bool, seed: int
) -> None:
    """What the BPMs make of the orbit is told from it, noise before their curve and after it."""
    rng = np.random.default_rng(seed)

    def noisy(orbit: Matrix) -> Matrix:
        return cubic(orbit + NOISE * rng.standard_normal(orbit.shape))

    sensed, noise_rms = (noisy, 0.1 * NOISE) if before else (cubic, NOISE)
    found = answer(make_record(seed, sensed=sensed, gain=0.1, noise_rms=noise_rms))
    assert found.state != "unknown"
    first, *others = found.causes
    assert first.effect == "bpm-nonlinearity"
    rest = sum(one.evidence_nats or 0.0 for one in others)
    assert rest < 0.05 * (first.evidence_nats or 0.0)  # a tangent is not quite a cubic


def test_probabilities_of_effects_and_of_none_are_one_together(told_reversed: Diagnosis) -> None:
    found = told_reversed
    assert found.tournament is not None
    told = [one.probability or 0.0 for one in found.tournament.rows]
    assert 0.98 < sum(told) <= 1.0 + 1e-6


def test_a_group_that_has_noise_in_common_is_told_by_its_bpms() -> None:
    """The fragment for the simulator takes devices, and no names of groups."""
    record = make_record(30, gain=0.0)
    common = 0.3e-6 * np.random.default_rng(1).standard_normal((len(record), 1))
    readings = record.readings.copy()
    readings[:, 4:8] += common
    first, *_ = answer(replace(record, readings=readings)).causes
    assert first.effect == "noise-correlated"
    assert first.places == ("B4", "B5", "B6", "B7")


def test_a_cause_with_rivals_comes_with_the_experiment_that_decides(
    told_reversed: Diagnosis,
) -> None:
    found = told_reversed
    assert found.causes[0].alternatives == ("corrector-gain",)
    assert found.experiment is not None
    assert found.experiment.splits == ("corrector-polarity", "corrector-gain")


def test_noise_that_follows_the_beam_is_no_noise_of_the_library() -> None:
    found = answer(make_record(27, sensed=louder_outside(1)))
    assert found.state == "unknown"
    assert "noise of all BPMs" in found.headline


def test_noise_with_tails_does_not_follow_the_beam() -> None:
    found = answer(make_record(28, sensed=with_tails(2)))
    assert (found.state, [one.effect for one in found.causes]) == ("named", ["noise-tails"])


@pytest.mark.parametrize("machine", ["damped-ground", "full-gain"])
def test_gains_of_some_bpms_are_alone_where_the_ground_or_the_loop_moves_much(
    tmp_path: Path, machine: str
) -> None:
    """To first order, or undone from a later row, they leave jumps and curves of the same BPMs."""
    name = many.write(machine, "bpm-gain", 42, tmp_path)
    found = diagnose_files(
        tmp_path / f"{name}.npz", None, None, planes=None, ring=Ring.load(None, None), seed=0,
        progress=lambda what, share: None,
    )  # fmt: skip
    (cause,) = found.causes
    assert (found.state, cause.effect, cause.onset_s) == ("named", "bpm-gain", None)
    assert len(cause.places) == 2


def test_a_tripped_corrector_is_alone_where_slow_ground_hides_the_half_of_it(
    tmp_path: Path,
) -> None:
    """Errors of its neighbours hide that it is one: by the scan three trip together."""
    name = many.write("smooth-ground", "trip", 56, tmp_path)
    found = diagnose_files(
        tmp_path / f"{name}.npz", None, None, planes=None, ring=Ring.load(None, None), seed=0,
        progress=lambda what, share: None,
    )  # fmt: skip
    (cause,) = found.causes
    assert (found.state, cause.effect, cause.places) == ("named", "corrector-stuck", ("C18",))


def test_two_effects_at_the_very_same_devices_are_rather_one_of_no_library() -> None:
    one = frozenset({"B1 (x)", "B2 (x)"}), 180
    other, none = (frozenset({"B2 (x)"}), 180), (frozenset[str](), 180)
    named = Judged("named", (), 0.0)
    assert beside_each_other(named, [one, other]) is named
    assert beside_each_other(named, [none, none]) is named
    unsure = Judged("ambiguous", (), 0.0)
    assert beside_each_other(unsure, [one, one]) is unsure
    found = beside_each_other(named, [one, other, one])
    assert (found.state, found.shared) == ("named_plus_remainder", ("B1 (x)", "B2 (x)"))
    assert found.explained == pytest.approx(1.0 / 91.0)  # 90 pairs of devices beside each other
    told = unknown_of(found, ())
    assert told is not None
    assert told.places == found.shared
    assert "coincidence" in told.text


def test_two_effects_of_the_whole_ring_are_rather_one_of_no_library() -> None:
    ring, named = (frozenset({RING}), 1), Judged("named", (), 0.0)
    assert beside_each_other(named, [ring]) is named
    found = beside_each_other(named, [ring, ring])
    assert (found.state, found.explained) == ("named_plus_remainder", 0.5)
    told = unknown_of(found, ())
    assert told is not None
    assert told.places == ()
    assert "of the whole ring" in told.text
