"""The tournament on small records made here: no ring, a response of random numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.core.signals import Vector
from orbitfb.diagnose import hypotheses, likelihood
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import _finer, _Found
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection import beside
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import EffectKind, Parameter, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.effects.registry import all_effects, effect
from orbitfb.estimation.priors import ALONE, MISFIT, SURE
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.physics.response import response
from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import (
    BPMS,
    CORRECTORS,
    NOISE,
    ROWS,
    Bent,
    kinds_for,
    lagging,
    make_record,
    remembered,
)

ONE_PERIOD = np.exp(-1.0)
"""Of a time constant of one period: the share that is left after it."""


def winner(record: Record, kinds: list[EffectKind]) -> Candidate:
    return candidates_of(Workspace.of(record, kinds), kinds, lambda text: None)[0]


def four_lagging() -> Bent:
    """Four correctors behind a time constant that lies between two of the grid."""
    lost = np.zeros(CORRECTORS)
    lost[[1, 2, 6, 9]] = np.exp(-0.1 / 0.079)
    return remembered(lambda state, row: state + (1.0 - lost) * (row - state))


def strong_third(currents: Matrix) -> Matrix:
    kicked = currents[-1:].copy()
    kicked[:, 3] *= 1.4
    return kicked


def later_strong_fifth(currents: Matrix) -> Matrix:
    """Corrector 5 kicks 60 % more from row 500 on."""
    kicked = currents[-1:].copy()
    if len(currents) > 500:
        kicked[:, 5] *= 1.6
    return kicked


def gains_of_two(orbit: Matrix) -> Matrix:
    read = orbit.copy()
    read[:, [2, 9]] *= [1.3, 0.75]
    return read


@pytest.mark.parametrize("seed", [11, 12])
def test_a_record_without_a_gap_has_no_sure_candidate(seed: int) -> None:
    record = make_record(seed)
    assert winner(record, kinds_for(record)).evidence < SURE


def test_a_lag_of_all_correctors_is_named_with_its_time_constant() -> None:
    record = make_record(13, currents=lagging(ONE_PERIOD))
    found = winner(record, kinds_for(record))
    assert (found.kind.id, found.places) == ("corrector-lag", ())
    assert found.values["tau"] == pytest.approx(0.1, rel=0.05)


def test_which_correctors_lag_is_sought_together_with_their_time_constant() -> None:
    """Too long a time for all of them strikes some of them only, and no time alone mends that."""
    record = make_record(14, currents=four_lagging())
    kind = effect("corrector-lag")
    space = Workspace.of(record, kinds_for(record))
    scorer, (law,) = Scorer.of(space), space.courses.laws(kind)
    assert isinstance(law, DeviceLaw)
    grid = space.courses.grid(kind)
    longer = min((one for one in grid if one["tau"] > 0.1), key=lambda one: one["tau"])
    scanned = _Found(100.0, (2, 9), longer, free=False)
    found = _finer(kind, law, scorer, grid, scanned)
    assert found.places == (1, 2, 6, 9)
    assert found.values["tau"] == pytest.approx(0.079, rel=0.02)


def test_a_gain_of_one_corrector_is_found_with_its_place_and_size() -> None:
    """Play that is wider than the setpoints move is a gain, so the two stay rivals."""
    record = make_record(14, currents=strong_third)
    kinds = kinds_for(record)
    best = candidates_of(Workspace.of(record, kinds), kinds, lambda text: None)
    assert best[0].places == (3,)
    found = next(one for one in best if one.kind.id == "corrector-gain")
    assert found.places == (3,)
    assert found.evidence > best[0].evidence - 15.0
    assert found.values["gain"] == pytest.approx(0.4, abs=0.04)


def test_a_gain_that_begins_late_is_found_with_its_onset() -> None:
    record = make_record(15, currents=later_strong_fifth)
    found = winner(record, kinds_for(record))
    assert (found.kind.id, found.places) == ("corrector-gain", (5,))
    assert found.onset == pytest.approx(500, abs=8)


def test_gains_of_two_bpms_are_named_with_their_sizes_and_nothing_is_left() -> None:
    record = make_record(16, sensed=gains_of_two)
    kinds = kinds_for(record)
    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["bpm-gain"]
    assert accepted[0].places == (2, 9)
    assert accepted[0].sizes == pytest.approx((0.3, -0.25), abs=0.04)
    assert rounds[-1].candidates[0].evidence < SURE


def reversed_fourth(currents: Matrix) -> Matrix:
    kicked = currents[-1:].copy()
    kicked[:, 4] *= -1.0
    return kicked


def test_a_corrector_the_wrong_way_round_in_a_large_motion_is_no_scatter_of_all_gains() -> None:
    """Ten thousand nats of one device, told to the nat beside healthy errors that are alike."""
    record = make_record(17, currents=reversed_fourth, gain=0.01)  # else it runs away
    kinds = kinds_for(record)
    first = candidates_of(Workspace.of(record, kinds), kinds, lambda text: None)
    assert (first[0].kind.id, first[0].places) == ("corrector-polarity", (4,))
    wide = next(one for one in first if one.kind.id == "corrector-gain" and not one.places)
    assert first[0].evidence > wide.evidence + SURE


def test_a_gradient_that_changes_late_kicks_by_the_orbit_that_stands_in_its_magnet() -> None:
    """The record tells changes of the orbit alone: the first kick may have any size."""
    ring, rng, late = small_ring(), np.random.default_rng(19), 400
    layout = layout_of(ring, "x", 0.1)
    quadrupole, change, stands = 20, 0.001, 150e-6
    errors = np.zeros(len(ring.places("QUAD")))
    errors[quadrupole] = change
    setpoints = (0.01 * rng.standard_normal((900, layout.response.shape[1]))).cumsum(axis=0)
    orbit = setpoints @ layout.response.T
    orbit[late:] += setpoints[late:] @ (response(ring, "x", errors) - layout.response).T
    orbit[late:] -= change * stands * layout.orbit_per_kick("QUAD", "x")[:, quadrupole]
    moved = (2e-9 * rng.standard_normal((900, len(errors)))).cumsum(axis=0)
    readings = orbit + moved @ layout.orbit_per_kick("QUAD", "x").T
    readings += NOISE * rng.standard_normal(readings.shape)
    made = make_record(19)
    record = replace(
        made, layout=layout, readings=readings, setpoints=setpoints,
        requested=np.vstack([np.diff(setpoints, axis=0), setpoints[:1] * np.nan]),
        filled=np.zeros_like(readings, dtype=np.bool_),
    )  # fmt: skip
    kinds = kinds_for(record)
    (found,), _ = tournament(Workspace.of(record, kinds), kinds)
    assert (found.kind.id, found.names) == (
        "quadrupole-gradient", (ring.names("QUAD")[quadrupole],)
    )  # fmt: skip
    assert found.onset == late
    assert found.values["gradient"] == pytest.approx(change, rel=0.25)


def test_a_reading_that_jumps_is_an_offset_from_that_row_on() -> None:
    record = make_record(18)
    readings = record.readings.copy()
    readings[400:, 6] += 15 * NOISE
    jumped = replace(record, readings=readings)
    found = winner(jumped, kinds_for(jumped))
    assert (found.kind.id, found.places, found.onset) == ("bpm-offset", (6,), 400)
    assert found.values["offset"] == pytest.approx(15 * NOISE, rel=0.25)


def test_bpms_of_a_cell_that_jump_by_the_same_are_an_offset_of_the_cell() -> None:
    """Each jumps by less than shows alone: twice its noise."""
    record = make_record(18)
    cells = tuple(f"K{number // 5}" for number in range(BPMS))
    layout = replace(record.layout, bpms=replace(record.layout.bpms, cells=cells))
    readings = record.readings.copy()
    readings[400:, 5:10] += 2.0 * NOISE
    jumped = replace(record, layout=layout, readings=readings)
    kinds = kinds_for(jumped)
    (found,), _ = tournament(Workspace.of(jumped, kinds), kinds)
    assert (found.kind.id, found.places) == ("bpm-offset", (5, 6, 7, 8, 9))
    assert found.onset == pytest.approx(400, abs=10)
    assert found.values["offset"] == pytest.approx(2.0 * NOISE, rel=0.1)


def test_a_size_without_a_meaning_is_not_told() -> None:
    """More of the current than there is cannot stay behind."""
    for seed in (11, 12, 13):
        record = make_record(seed)
        kinds = [kind for kind in kinds_for(record) if kind.id == "corrector-hysteresis"]
        for one in candidates_of(Workspace.of(record, kinds), kinds, lambda text: None):
            if one.field is not None:
                assert abs(one.values["share"]) <= 1.0


def test_a_loop_without_dither_shows_no_delay_that_is_not_there() -> None:
    """Setpoints that follow the noise of readings tell nothing of a delay, if all is weighed right.

    Weights that are the same over a band of frequencies tell of one.
    """
    told = 0.0
    for seed in range(30, 34):
        record = make_record(seed, gain=0.9, dither=0.0)
        space = Workspace.of(record, kinds_for(record))
        late = np.vstack([record.setpoints[:1], record.setpoints[:-1]]) - record.setpoints
        field = space.transform.spectrum(late) @ record.layout.response.T
        pull, information = Scorer.of(space).evaluate([field])
        told += float(pull[0] ** 2 / (2.0 * information[0, 0]))
    assert told < 10.0


def rolled(angles: Vector) -> Record:
    """BPMs of two planes, turned about the beam: y_x = x cos φ + y sin φ, from the definition."""
    count = BPMS // 2

    def turned(orbit: Matrix) -> Matrix:
        x, y = orbit[:, :count], orbit[:, count:]
        cos, sin = np.cos(angles), np.sin(angles)
        return np.hstack([x * cos + y * sin, y * cos - x * sin])

    record = make_record(19, sensed=turned)
    names = tuple(f"B{i}" for i in range(count))
    bpms = Devices(names * 2, ("x",) * count + ("y",) * count, ("",) * BPMS)
    return replace(record, layout=replace(record.layout, bpms=bpms))


def told_angles(one: Candidate) -> dict[str, float]:
    parts = one.parts or (one,)
    return {part.names[0].split(" ")[0]: part.values["angle"] for part in parts}


@pytest.mark.nightly
def test_rolls_of_three_bpms_are_one_cause_with_an_angle_each() -> None:
    angles = np.zeros(BPMS // 2)
    angles[[1, 4, 6]] = [0.1, -0.06, 0.2]
    record = rolled(angles)
    kinds = kinds_for(record)
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["bpm-roll"]
    assert told_angles(accepted[0]) == pytest.approx({"B1": 0.1, "B4": -0.06, "B6": 0.2}, abs=0.03)


def test_rolls_of_all_bpms_are_one_cause_of_all_with_an_angle_each() -> None:
    angles = 0.05 * np.random.default_rng(20).standard_normal(BPMS // 2)
    record = rolled(angles)
    kinds = kinds_for(record)
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    assert [(one.kind.id, one.places) for one in accepted] == [("bpm-roll", ())]
    assert accepted[0].values["angle"] == pytest.approx(np.sqrt(np.mean(angles**2)), rel=0.2)
    told = told_angles(accepted[0])
    assert [told[f"B{i}"] for i in range(len(angles))] == pytest.approx(angles, abs=0.02)


class Sticky(ActuatorKind):
    """An effect that the package does not know: a current that moves in steps of 0.1 A, down."""

    id = "test-sticky"
    stage = "actuator"
    title = "sticky current"
    sentence = "The current moves in steps."
    equation = "θ = s floor(u / s)"
    parameters = (Parameter("step", "A", 0.0, 1.0, 0.0, 0.1, "Step s."),)

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        return np.floor(setpoints / values["step"]) * values["step"]

    def grid(self, record: Record) -> tuple[Values, ...]:
        return tuple({"step": step} for step in (0.05, 0.1, 0.2))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        raise AssertionError("this test makes its own record")


def test_an_effect_of_a_file_of_its_own_is_found_with_nothing_else_touched() -> None:
    def floored(currents: Matrix) -> Matrix:
        return np.floor(currents[-1:] / 0.1) * 0.1

    record = make_record(17, currents=floored)
    found = winner(record, [*kinds_for(record), Sticky()])
    assert (found.kind.id, found.places) == ("test-sticky", ())
    assert found.values["step"] == pytest.approx(0.1)


def test_the_engine_knows_no_effect_by_its_name() -> None:
    """Ids of effects stand in effects only."""
    for package in (hypotheses, likelihood):
        for path in Path(package.__path__[0]).glob("*.py"):
            text = path.read_text(encoding="utf-8")
            named = [name for name in all_effects() if f'"{name}"' in text]
            assert not named, f"{path.name}: {named}"


def test_the_floor_of_a_record_is_that_which_it_was_made_with() -> None:
    record = make_record(18)
    space = Workspace.of(record, kinds_for(record))
    sigma: Vector = np.sqrt(np.diag(space.noise.white))
    assert sigma == pytest.approx(np.full(BPMS, NOISE), rel=0.15)
    walk = np.mean(np.sum(record.layout.response**2, axis=1)) * 1e-6
    assert np.trace(space.noise.walk) / BPMS == pytest.approx(walk, rel=0.3)


def test_a_ring_without_any_drift_that_is_moved_far_shows_no_strokes() -> None:
    """What is all noise in a mode is not weighed as if the mode told less."""
    record, rng = make_record(42, gain=0.0), np.random.default_rng(42)
    setpoints = rng.standard_normal(record.setpoints.shape).cumsum(axis=0)
    noise = NOISE * rng.standard_normal(record.readings.shape)
    readings = setpoints @ record.layout.response.T + noise
    moved = replace(record, setpoints=setpoints, readings=readings)
    assert winner(moved, kinds_for(moved)).evidence < SURE


def test_floors_are_compared_though_the_prior_of_the_walk_is_singular() -> None:
    record = make_record(18)
    space = Workspace.of(record, kinds_for(record))
    size, modes = np.linalg.eigh(space.shape)
    size[0] = 0.0
    singular = replace(space, shape=(modes * size) @ modes.T)
    assert np.isfinite(singular.log_posterior())


def gain_of_one(orbit: Matrix) -> Matrix:
    read = orbit.copy()
    read[:, 5] *= 1.08
    return read


def test_a_small_error_of_one_device_is_told_beside_a_large_law_of_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It has less than the law would leave to others if it were a little wrong.

    Unless the same effect then finds as much at other devices.
    """
    record = make_record(31, lagging(ONE_PERIOD), gain_of_one, dither=0.05)
    kinds = kinds_for(record)
    accepted, tried = tournament(Workspace.of(record, kinds), kinds)
    assert [(one.kind.id, one.names) for one in accepted] == [
        ("corrector-lag", ()), ("bpm-gain", ("B5 (x)",)),
    ]  # fmt: skip
    law, small = accepted
    assert small.evidence < MISFIT * law.evidence
    for share, alone in ((0.5 * ALONE, True), (5.0 * ALONE, False)):
        rest = [replace(small, evidence=share * small.evidence)]
        monkeypatch.setattr(beside, "candidates_of", lambda space, kinds, its=rest: its)
        assert beside._stands_out(tried[1].candidates[0], [law], tried[1].space) == alone


def unlike(state: Vector, row: Vector) -> Vector:
    """Every corrector follows upwards a tenth faster than downwards."""
    step = row - state
    return state + (1.0 - ONE_PERIOD) * step * np.where(step > 0.0, 1.1, 0.9)


def test_a_law_that_is_a_little_wrong_is_no_further_cause() -> None:
    record = make_record(32, remembered(unlike), dither=0.05)
    kinds = kinds_for(record)
    accepted, tried = tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["corrector-lag"]
    assert tried[-1].candidates[0].evidence > SURE


def test_rows_of_a_record_in_pieces_are_told() -> None:
    """Steps are numbered without the holes, rows with them; the law begins late in the record."""

    def late(currents: Matrix) -> Matrix:
        kicked = currents[-1:].copy()
        if len(currents) > ROWS - 100:
            kicked[:, 5] *= 1.6
        return kicked

    record = make_record(33, late)
    starts = record.starts.copy()
    starts[20 : ROWS - 120 : 30] = True
    broken = replace(record, starts=starts)
    best = winner(broken, [effect("corrector-gain")])
    assert (best.kind.id, best.names) == ("corrector-gain", ("C5 (x)",))
    assert abs(best.onset - (ROWS - 100)) <= 2
