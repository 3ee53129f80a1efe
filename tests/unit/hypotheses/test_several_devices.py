"""Several devices at once: all of them with a size each, groups that begin late, unknown optics."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.fodo import response
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.onsets.scan import _hopeful_sets
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.build import layout_of
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.effects.optics.gradients import gradient_scatters, nearest_bpms, response_with
from orbitfb.effects.registry import effect
from orbitfb.estimation.priors import ONSET_SIGN
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import BPMS, kinds_for, make_record


def best_of(record: Record, *names: str) -> Candidate:
    kinds = [kind for kind in kinds_for(record) if not names or kind.id in names]
    return candidates_of(Workspace.of(record, kinds_for(record)), kinds)[0]


def test_a_saw_tooth_of_all_bpms_is_that_of_the_stored_current() -> None:
    """The floor may have any pattern: what all BPMs do at once is seen by all of them only."""
    record = make_record(7)
    each = 2e-6 * np.random.default_rng(8).standard_normal(BPMS)
    saw = 0.5 - np.mod(record.time + 4.33, 9.7) / 9.7
    found = best_of(replace(record, readings=record.readings + np.outer(saw, each)))
    assert (found.kind.id, found.places) == ("bpm-current", ())
    assert found.values["period"] == pytest.approx(9.7, abs=0.02)
    assert np.corrcoef(found.sizes, each)[0, 1] > 0.99


def test_a_recorded_current_leaves_no_saw_tooth_to_be_sought() -> None:
    record = make_record(7)
    current = 0.5 - 1e-4 * record.time
    kind = effect("bpm-current")
    signals = record.setpoints, lambda: record.readings
    assert kind.proposed(*signals, replace(record, auxiliary={"current": current})) == ()
    assert [p.name for p in kind.fitted(replace(record, auxiliary={"current": current}))] == [
        "slope"
    ]


def in_cells(devices: Devices) -> Devices:
    return replace(devices, cells=tuple(f"C{i // 4}" for i in range(len(devices))))


def test_bpms_of_a_cell_whose_gain_changes_late_are_found_with_their_onset() -> None:
    """Over the whole record their healthy errors stand in for it."""
    record = make_record(9, dither=0.1)
    layout = replace(record.layout, bpms=in_cells(record.layout.bpms))
    readings = record.readings.copy()
    readings[450:, 4:8] *= 1.04
    found = best_of(replace(record, layout=layout, readings=readings))
    assert (found.kind.id, found.places) == ("bpm-gain", (4, 5, 6, 7))
    assert found.onset == pytest.approx(450, abs=3)
    assert found.values["gain"] == pytest.approx(0.04, abs=0.01)


@pytest.mark.parametrize("seed", [32, 33])
def test_the_value_of_a_cell_that_begins_late_is_sought_with_its_onset(seed: int) -> None:
    """With values of the grid alone it would not be told from one that was always there."""
    kept, before = np.exp(-0.1 / 0.045), []

    def averaged(orbit: Matrix) -> Matrix:
        before.append(orbit[0].copy())
        if len(before) > 400:
            orbit[0, 4:8] += kept * (before[-2] - before[-1])[4:8]
        return orbit

    record = make_record(seed, sensed=averaged)
    layout = replace(record.layout, bpms=in_cells(record.layout.bpms))
    found = best_of(replace(record, layout=layout), "bpm-lowpass")
    assert found.places == (4, 5, 6, 7)
    assert found.onset == pytest.approx(400, abs=10)
    assert found.values["tau"] == pytest.approx(0.045, rel=0.15)


def test_a_cell_is_looked_at_though_none_of_its_devices_shows_much() -> None:
    record = make_record(9)
    layout = replace(record.layout, bpms=in_cells(record.layout.bpms))
    kinds = [effect("bpm-gain")]
    scorer = Scorer.of(Workspace.of(replace(record, layout=layout), kinds))
    (law,) = scorer.space.courses.laws(kinds[0])
    assert isinstance(law, DeviceLaw)
    spectra = scorer.space.courses.spectra(law, {"gain": 0.01})
    cell, pull = list(law.groups.values())[1], np.zeros(BPMS)
    _, (own,) = scorer.together(law.patterns[0], spectra[0], [cell])
    pull[cell] = 0.3 * np.sqrt(2.0 * ONSET_SIGN * own)  # a little more than a fourth each
    found = [one.tolist() for one in _hopeful_sets(law, scorer, pull, spectra, every=False)]
    assert cell.tolist() in found
    assert next(iter(law.groups.values())).tolist() not in found


def test_a_corrector_that_is_stuck_in_the_last_third_is_found() -> None:
    """A law of a given size that begins late has less than no evidence in the whole record."""

    def stuck(currents: Matrix) -> Matrix:
        acting = currents[-1:].copy()
        acting[0, 3] = currents[min(len(currents) - 1, 620), 3]
        return acting

    found = best_of(make_record(10, stuck), "corrector-stuck")
    assert found.places == (3,)
    assert found.onset == pytest.approx(620, abs=3)
    assert found.evidence > 100.0


def test_exchanged_correctors_in_a_large_motion_are_told_beside_the_errors_of_others() -> None:
    """Errors of one per cent take nearly all information of a large effect."""

    def exchanged(currents: Matrix) -> Matrix:
        acting = currents[-1:].copy()
        acting[0, [2, 7]] = acting[0, [7, 2]]
        return acting

    record = make_record(11, exchanged, gain=0.008, dither=0.02)
    found = best_of(record, "corrector-swap", "corrector-gain", "corrector-polarity")
    assert (found.kind.id, found.places) == ("corrector-swap", (2, 7))


def test_errors_of_unknown_quadrupoles_change_the_response_as_those_at_the_correctors() -> None:
    """Against one-turn matrices of a ring of thin lenses, which know no formula of orbits."""
    count = 24
    model = response(np.zeros(count)) * 50e-6
    changed = response(1e-3 * np.random.default_rng(12).standard_normal(count)) * 50e-6 - model
    record = make_record(13)
    devices = Devices(tuple(f"D{i}" for i in range(count)), ("x",) * count, ("",) * count)
    layout = replace(record.layout, bpms=devices, correctors=devices, response=model)
    still = np.zeros((count, count))
    its = replace(
        record, layout=layout, readings=still, setpoints=np.eye(count), time=np.arange(count) * 0.1,
        starts=np.arange(count) == 0, requested=still, filled=still > 0.0,
    )  # fmt: skip
    kind = effect("quadrupole-gradient")
    assert not kind.unavailable(its)
    law = next(
        one for one in kind.laws(Signals(its, np.eye(count), still)) if isinstance(one, DeviceLaw)
    )
    (course,) = law.course({"gradient": 1.0}, Signals(its, np.eye(count), still))
    columns = np.einsum("np,tp->ntp", law.patterns[0], course).reshape(count**2, count)
    sizes = np.linalg.lstsq(columns, changed.ravel(), rcond=None)[0]
    left = changed.ravel() - columns @ sizes
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(changed)
    limit = kind.healthy_scatter(layout)
    assert limit is not None
    drawn = columns @ (limit * np.random.default_rng(14).standard_normal((200, count))).T
    share = np.sqrt(np.mean(np.sum(drawn**2, axis=0))) / np.linalg.norm(model)
    assert share == pytest.approx(0.03, rel=0.15)


def test_on_the_default_ring_they_make_what_all_its_quadrupoles_do() -> None:
    """Against the exact response of all errors together."""
    layout = layout_of(Ring.load(), "x", 0.1)
    gradients = gradient_scatters(layout) * np.random.default_rng(15).standard_normal(300)
    changed = response_with(layout, gradients) - response_with(layout, np.zeros(300))
    unknown = replace(layout, ring=None)
    near, columns = nearest_bpms(unknown), layout.response
    gram = (columns.T @ columns) * (columns[near] @ columns[near].T)
    pull = np.einsum("na,nc,ac->a", columns, changed, columns[near], optimize=True)
    sizes = np.linalg.lstsq(gram, pull, rcond=1e-12)[0]
    left = changed - (columns * sizes) @ columns[near]
    assert np.linalg.norm(left) < 0.02 * np.linalg.norm(changed)
