"""Laws of two devices."""

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import make_record

PAIR = [2, 7]


@pytest.mark.parametrize("row", [0, 400])
def test_healthy_errors_follow_the_currents_that_a_pair_has(row: int) -> None:
    """An exchange is none of the errors of what was asked: those of the beam's currents are."""

    def exchanged(currents: Matrix) -> Matrix:
        acting = currents[-1:].copy()
        if len(currents) > row:
            acting[:, PAIR] = acting[:, PAIR[::-1]]
        return acting

    record = make_record(31, exchanged, gain=0.0)  # a loop would run away
    kind = effect("corrector-swap")
    space = Workspace.of(record, [effect("corrector-gain"), kind])
    best = candidates_of(space, [kind])[0]
    assert (best.places, best.onset) == (tuple(PAIR), row)
    acting = record.setpoints.copy()
    acting[row:, PAIR] = acting[row:, PAIR[::-1]]
    np.testing.assert_allclose(best.accepted(space).signals.currents, acting)
