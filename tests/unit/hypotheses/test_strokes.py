"""Strokes at single rows, also where a record is in pieces of all lengths."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.random_laws import pursued
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.estimation.transform import StepTransform
from tests.unit.hypotheses.small_records import NOISE, kinds_for, make_record


def test_strokes_are_found_at_their_rows_with_their_sizes() -> None:
    """The weight of a row is large in a long piece and small in a short one."""
    rng = np.random.default_rng(1)
    starts = np.zeros(800, dtype=bool)
    starts[:400:2] = True
    starts[400] = True
    transform = StepTransform.of(starts)
    weights = 1.0 / (0.05 + transform.eigenvalue)
    true = np.zeros(len(transform))
    places = np.array([20, 100, 300, 390, 500])
    true[places] = np.array([30.0, -30.0, 25.0, -40.0, 35.0])
    noise = np.sqrt(weights) * rng.standard_normal(len(transform))
    pull = transform.turn((weights * transform.turn(true[:, None])[:, 0] + noise)[:, None])[:, 0]
    evidence, found = pursued(pull, weights, transform)
    assert set(places) <= set(np.flatnonzero(found))
    np.testing.assert_allclose(found[places], true[places], rtol=0.1)
    most = 0.5 * float(true @ pull)
    assert 0.5 * most < evidence < 1.1 * most


def test_an_offset_that_moves_in_steps_is_one_cause_with_all_its_steps() -> None:
    rng = np.random.default_rng(5)
    record = make_record(41)
    rows = np.sort(rng.choice(np.arange(20, 880), 12, replace=False))
    steps = NOISE * rng.uniform(10.0, 30.0, len(rows)) * rng.choice([-1.0, 1.0], len(rows))
    readings = record.readings.copy()
    for row, step in zip(rows, steps, strict=True):
        readings[row:, 6] += step
    record = replace(record, readings=readings)
    space = Workspace.of(record, kinds_for(record))
    (found,), _ = tournament(space, kinds_for(record))
    assert (found.kind.id, found.names) == ("bpm-walk", ("B6 (x)",))
    told = np.diff(space.transform.summed(np.asarray(found.field))[:, 6])
    np.testing.assert_array_equal(1 + np.flatnonzero(abs(told) > 3.0 * NOISE), rows)
    np.testing.assert_allclose(told[rows - 1], steps, atol=3.0 * NOISE)
