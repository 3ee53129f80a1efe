"""Weak causes that ground of any shape takes up, and even ground does not."""

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import Round, tournament
from orbitfb.diagnose.selection.search import search
from orbitfb.estimation.priors import SURE
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import NOISE, kinds_for, recorded, some_devices

ROWS, STEP, PLACE = 800, 2e-9, 60
"""Rows, how far every quadrupole walks in one [rad], and the quadrupole that does more."""


def standing_on(ground: float = 1.0, ramp: float = 0.0, seed: int = 3) -> Record:
    """A ring of 60 BPMs whose quadrupoles walk, without feedback.

    Args:
        ground: How much more one of them walks than the others [1].
        ramp: What that one kicks more in every row [rad].
        seed: Of everything drawn.
    """
    rng = np.random.default_rng(seed)
    layout = some_devices(3)
    orbit = layout.orbit_per_kick("QUAD", "x")
    steps = STEP * rng.standard_normal((ROWS, orbit.shape[1]))
    steps[:, PLACE] *= ground
    kicks = steps.cumsum(axis=0)
    kicks[:, PLACE] += ramp * np.arange(ROWS)
    setpoints = 1e-3 * rng.standard_normal((ROWS, len(layout.correctors)))
    noise = NOISE * rng.standard_normal((ROWS, len(layout.bpms)))
    return recorded(layout, setpoints, kicks @ orbit.T + setpoints @ layout.response.T + noise)


def workspace(record: Record) -> Workspace:
    return Workspace.of(record, kinds_for(record))


@pytest.mark.parametrize("seed", [2, 3])
def test_a_weak_ramp_is_found_over_even_ground_alone(seed: int) -> None:
    record = standing_on(ramp=1.5e-9, seed=seed)
    kinds = kinds_for(record)
    assert tournament(workspace(record), kinds)[0] == []
    (found,), _ = search(workspace(record), kinds)
    assert found.evidence > SURE
    assert found.names[0].split(" ")[0].endswith("C06")
    ring = record.layout.known_ring
    assert ring.names("QUAD")[PLACE].endswith("C06")


def test_a_healthy_ring_has_no_cause_over_even_ground() -> None:
    record = standing_on()
    kinds = kinds_for(record)
    even = workspace(record).even()
    assert even.unevenness() < SURE
    accepted, rounds = tournament(even, kinds)
    assert accepted == []
    assert rounds[-1].unknown == ()


def test_where_ground_is_surely_uneven_nothing_more_is_sought(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record = standing_on(ground=12.0)
    space = workspace(record)
    assert space.unevenness() == 0.0  # it may be uneven: nothing is owed
    assert space.even().unevenness() > SURE
    assert search(space, kinds_for(record))[0] == []  # over even ground the body has a name
    over: list[bool] = []

    def nothing(its: Workspace, *given: object) -> tuple[list[Candidate], list[Round]]:
        over.append(its.is_even)
        return [], [Round(its, (), ())]

    monkeypatch.setattr("orbitfb.diagnose.selection.search.tournament", nothing)
    search(space, kinds_for(record))
    assert over == [False]
    search(workspace(standing_on()), kinds_for(record))
    assert over == [False, False, True]


def test_even_ground_stays_even() -> None:
    even = workspace(standing_on(ground=12.0)).even().trusting().with_floor()
    shapes = even.shapes
    assert shapes.single.shape[1] == 0
    np.testing.assert_allclose(even.noise.walk, shapes.total(even.weights), rtol=1e-6)
