"""A deaf device is not believed to answer, however loud the question and busy the loop."""

import numpy as np
import pytest

from orbitfb.safety.answers.answering import ANSWERED, SILENT
from orbitfb.safety.answers.evidence import Test as Sums
from orbitfb.safety.answers.evidence import ask_devices
from orbitfb.safety.answers.expectation import Expectation
from orbitfb.safety.answers.questions import Question, Ring, Sight

N, M, DEAF = 40, 30, 2
NOISE, SEEDS, ORBITS = 0.1e-6, 12, 60


def ask(seed, size, busy, corrector=0.0, bpm=1.0, dead=0, shape=(N, M)):
    """Ask a ring that one device answers by a share; give the evidence after every orbit.

    `busy` is what the loop itself changes [A rms], `dead` the BPMs that do not count.
    """
    (n, m), random = shape, np.random.default_rng(seed)
    response = 3e-4 * random.standard_normal(shape)
    ring, sums = Ring.of(response, np.ones(m, dtype=bool)), Sums.none(2, n + m)
    takes, sees, valid = np.ones(m), np.ones(n), np.arange(n) >= dead
    takes[DEAF], sees[-1] = corrector, bpm
    orbit, expected, evidence = np.zeros(n), Expectation.first(np.zeros(n), m), []
    for tick in range(40 + ORBITS):
        change, question = np.zeros(m), None
        if tick >= 40:  # the loop knows the noise of a calm ring, then closes
            excursion = size * ring.patterns @ random.choice([-1.0, 1.0], ring.patterns.shape[1])
            change = busy * random.standard_normal(m) + excursion
            question = Question(size, excursion, response @ excursion, expected.still)
        orbit = orbit + response @ (takes * change)
        position, moved = sees * orbit + NOISE * random.standard_normal(n), response @ change
        after = expected.follow(position, moved, change, valid)
        surprise = expected.surprise(position, moved)
        sight = Sight(position, valid, surprise, expected.spread, after.recent)
        expected = after
        if question is not None and not sight.kicked((question,)):
            sums = ask_devices(sums, sight, question, None, ring)
            evidence.append((sums.sure, sums.doubt))
    return np.max(evidence, axis=0)


@pytest.mark.parametrize("size", [0.2e-6, 2e-6, 5e-6])
@pytest.mark.parametrize("busy", [0.0, 0.3e-3, 3e-3, 30e-3])
def test_a_deaf_corrector_is_not_credited(size, busy):
    for seed in range(SEEDS):
        sure, _ = ask(seed, size, busy)
        assert sure[N + DEAF] < ANSWERED, seed


def test_nor_one_of_a_ring_half_of_whose_bpms_do_not_count():
    for seed in range(SEEDS):
        sure, _ = ask(seed, 2e-6, 0.3e-3, dead=20)
        assert sure[N + DEAF] < ANSWERED, seed


@pytest.mark.parametrize(("size", "busy"), [(0.2e-6, 0.0), (2e-6, 0.0), (2e-6, 0.3e-3)])
def test_all_that_answer_are_credited_and_none_is_called_silent(size, busy):
    for seed in range(SEEDS):
        sure, doubt = ask(seed, size, busy, corrector=1.0)
        assert sure.min() >= ANSWERED, seed
        assert doubt.max() < SILENT, seed


def test_a_loud_question_is_soon_answered_by_all_correctors_of_a_small_ring():
    """Answers that are clipped to the noise no longer tell neighbours apart."""
    for seed in range(SEEDS):
        sure, _ = ask(seed, 5e-6, 0.0, corrector=1.0, shape=(24, 16))
        assert sure.min() >= ANSWERED, seed


def test_a_dead_bpm_is_called_silent_and_not_credited():
    for seed in range(SEEDS):
        sure, doubt = ask(seed, 2e-6, 0.0, corrector=1.0, bpm=0.0)
        assert doubt[N - 1] >= SILENT, seed
        assert sure[N - 1] < ANSWERED, seed
