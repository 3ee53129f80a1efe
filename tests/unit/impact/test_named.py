"""How probable a cause is, though a law that no library has may look like it."""

import numpy as np
import pytest

from orbitfb.diagnose.impact.named import listed_chance
from orbitfb.estimation.priors import HIDDEN, REMAINDER, UNLISTED


@pytest.mark.parametrize("evidence", [30.0, 300.0, 3000.0])
def test_a_cause_is_as_probable_as_in_draws_of_faults(evidence: float) -> None:
    """Faults of any size, some of a law of no library, of which any share looks like a listed one.

    Of those that look like a cause of about this evidence, and leave nothing that shows.
    """
    rng, count = np.random.default_rng(7), 4_000_000
    sizes = np.exp(rng.uniform(np.log(1.0), np.log(1e7), count))
    unlisted = rng.random(count) < UNLISTED / (1.0 + UNLISTED)
    share = np.where(unlisted, rng.random(count), 1.0)
    seen, left = share * sizes, (1.0 - share) * sizes
    alike = (np.abs(np.log(seen / evidence)) < 0.05) & (left < HIDDEN + REMAINDER * seen)
    expected = np.mean(~unlisted[alike])
    spread = np.sqrt(expected * (1.0 - expected) / np.count_nonzero(alike))
    assert listed_chance(evidence) == pytest.approx(expected, abs=4.0 * spread)


def test_weak_evidence_is_not_certain_and_large_evidence_is() -> None:
    assert listed_chance(0.0) == pytest.approx(1.0 / (1.0 + UNLISTED))
    assert listed_chance(30.0) < 0.9 < listed_chance(100.0)
    assert listed_chance(1e5) > 0.99
