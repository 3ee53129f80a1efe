"""BPMs that are exchanged, or of the other sign, in loops that run away by it."""

import pytest

from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import Bent, kinds_for, make_record

ROWS = 300


def exchanged(orbit: Matrix) -> Matrix:
    read = orbit.copy()
    read[:, [2, 7]] = orbit[:, [7, 2]]
    return read


def reversed_sign(orbit: Matrix) -> Matrix:
    read = orbit.copy()
    read[:, 7] *= -1.0
    return read


@pytest.mark.parametrize(
    ("sensed", "kind", "places", "onset"),
    [
        (exchanged, "bpm-swap", (2, 7), 0),
        (exchanged, "bpm-swap", (2, 7), 131),
        (reversed_sign, "bpm-polarity", (7,), 0),
        (reversed_sign, "bpm-polarity", (7,), 131),
    ],
)
def test_one_cause_is_told_from_its_row_on(
    sensed: Bent, kind: str, places: tuple[int, ...], onset: int
) -> None:
    """The floor of all knows what they do for noise of these BPMs, and needs turns to leave it."""
    rows = iter(range(ROWS))

    def late(orbit: Matrix) -> Matrix:
        return sensed(orbit) if next(rows) >= onset else orbit

    record = make_record(0, sensed=late, gain=0.05, rows=ROWS)
    kinds = kinds_for(record)

    accepted, _ = tournament(Workspace.of(record, kinds), kinds)

    assert [(one.kind.id, one.places, one.onset) for one in accepted] == [(kind, places, onset)]
