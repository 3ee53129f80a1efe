"""All devices, each by a size of its own: from a row on, or always."""

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.onsets.every import shown_together
from orbitfb.diagnose.impact.pieces import pieces_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.physics.response import response
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import BPMS, NOISE, kinds_for, make_record, recorded

LATE = 400


def only(record: Record) -> tuple[Candidate, Workspace]:
    kinds = kinds_for(record)
    (found,), rounds = tournament(Workspace.of(record, kinds), kinds)
    return found, rounds[-1].space


def test_gradients_of_all_quadrupoles_that_change_late_are_one_cause() -> None:
    """The orbit that stands in each of them kicks by any size at that row."""
    ring, rng = small_ring(), np.random.default_rng(31)
    layout = layout_of(ring, "x", 0.1)
    errors = 5e-4 * rng.standard_normal(len(ring.places("QUAD")))
    stands = 1e-4 * rng.standard_normal(len(errors))
    per_kick = layout.orbit_per_kick("QUAD", "x")
    setpoints = (0.01 * rng.standard_normal((900, layout.response.shape[1]))).cumsum(axis=0)
    orbit = setpoints @ layout.response.T
    orbit[LATE:] += setpoints[LATE:] @ (response(ring, "x", errors) - layout.response).T
    orbit[LATE:] -= per_kick @ (errors * stands)
    orbit += (2e-9 * rng.standard_normal((900, len(errors)))).cumsum(axis=0) @ per_kick.T
    readings = orbit + NOISE * rng.standard_normal(orbit.shape)
    found, space = only(recorded(layout, setpoints, readings))
    assert (found.kind.id, found.places, found.onset) == ("quadrupole-gradient", (), LATE)
    assert found.values["gradient"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.2)
    assert np.corrcoef(found.sizes, errors)[0, 1] > 0.9
    pieces = pieces_of(found, space, np.zeros(len(space.terms)), {})
    assert [one.names for one in pieces] == [(name,) for name in ring.names("QUAD")]
    assert [one.values["gradient"] for one in pieces] == pytest.approx(list(found.sizes))


@pytest.mark.parametrize("scatter", [0.05, 0.02])
def test_gains_of_all_bpms_that_change_late_are_one_cause(scatter: float) -> None:
    """In no loop, as that would follow what they say."""
    rng = np.random.default_rng(32)
    gains = scatter * rng.standard_normal(BPMS)
    record = make_record(34)
    late = (np.arange(len(record.readings)) >= LATE)[:, None]
    kicks = 0.05 * rng.standard_normal(record.setpoints.shape)
    setpoints = kicks.cumsum(axis=0)
    walk = (0.02 * kicks[::-1]).cumsum(axis=0)
    orbit = (setpoints + walk) @ record.layout.response.T
    readings = orbit * (1.0 + gains * late) + NOISE * rng.standard_normal(orbit.shape)
    found, _ = only(recorded(record.layout, setpoints, readings))
    assert (found.kind.id, found.places) == ("bpm-gain", ())
    assert found.onset == LATE
    assert found.sizes == pytest.approx(list(gains), abs=0.01)


def test_what_a_single_device_shows_at_its_neighbours_is_not_all_of_them() -> None:
    alone, all_of_them = np.zeros((2, 40)), np.full((2, 40), 10.0)
    alone[:, 3:6] = 30.0, 80.0, 30.0
    assert not np.any(shown_together(alone))
    assert np.all(shown_together(all_of_them) > 0.0)


def test_large_gains_of_all_bpms_are_undone_with_the_walk_that_they_read() -> None:
    """To first order they are errors of the answers to correctors, and the ground is as it was."""
    gains = 0.15 * np.random.default_rng(31).standard_normal(BPMS)
    record = make_record(31, sensed=lambda orbit: orbit * (1.0 + gains))
    kinds = kinds_for(record)

    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)

    (found,) = accepted
    assert (found.kind.id, found.places, found.onset) == ("bpm-gain", (), 0)
    assert found.sizes == pytest.approx(gains, abs=0.03)
    first_order = next(one for one in rounds[0].candidates if one.raised)
    assert rounds[0].candidates[0].evidence > first_order.evidence + 15.0
