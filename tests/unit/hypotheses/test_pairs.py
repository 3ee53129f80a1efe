"""Laws of two devices."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.generator.cases import Spec
from benchmarks.blind.generator.generate import write_case
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring
from orbitfb.records.reading.load import load
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


def test_the_best_pair_is_the_best_beside_healthy_errors(tmp_path: Path) -> None:
    """Without these a neighbour of the true pair had 280 nats and that itself 257, not 396."""
    spec = Spec(("corrector-crosstalk",), 30.0, "xy", "second", "white", 1700, 300, 1782751862)
    for folder in ("truth", "later"):
        (tmp_path / folder).mkdir()
    write_case(spec, "case", tmp_path, tmp_path / "truth", 57)
    ring = Ring.load(tmp_path / "second-ring.csv", tmp_path / "second-ring.json")
    record = load(tmp_path / "case.npz", planes=None, ring=ring).record
    kind = effect("corrector-crosstalk")
    healthy = [effect(one) for one in ("corrector-gain", "bpm-gain", "quadrupole-gradient")]
    best = candidates_of(Workspace.of(record, [*healthy, kind]), [kind])[0]
    assert best.names == ("HB_D01 (x)", "HA_D01 (x)")
