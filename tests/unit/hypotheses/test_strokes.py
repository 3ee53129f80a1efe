"""Strokes at single rows, also where a record is in pieces of all lengths."""

import numpy as np

from orbitfb.diagnose.hypotheses.random_laws import pursued
from orbitfb.estimation.transform import StepTransform


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
