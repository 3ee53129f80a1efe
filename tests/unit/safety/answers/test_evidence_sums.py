"""The sums of the evidence are those that its docstring writes, worked out one by one."""

import numpy as np
import pytest

from orbitfb.safety.answers.evidence import LITTLE, MUCH, ask_at_any, ask_devices, ask_ring
from orbitfb.safety.answers.evidence import Test as Sums
from orbitfb.safety.answers.questions import CLIP, Question, Ring, Sight

N, M, LAGS, USUAL = 12, 9, 3, 1
SPREAD = 0.3e-6


@pytest.fixture(scope="module")
def ring():
    response = 3e-4 * np.random.default_rng(1).standard_normal((N, M))
    return Ring.of(response, np.ones(M, dtype=np.bool_))


@pytest.fixture(scope="module")
def asked(ring):
    """Questions, newest first, one of them not asked, and an orbit where a BPM does not count."""
    random = np.random.default_rng(3)
    questions = []
    for size in (0.2e-6, 0.3e-6, 0.5e-6):
        excursion = size * ring.patterns @ random.choice([-1.0, 1.0], ring.patterns.shape[1])
        still = 0.1e-6 * random.standard_normal(N)
        questions.append(Question(size, excursion, ring.response @ excursion, still))
    questions[2] = None
    position, surprise = 1e-6 * random.standard_normal((2, N))
    spread, recent = np.full(N, SPREAD), 3e-3 * random.standard_normal(M)
    valid = np.arange(N) != 4
    return tuple(questions), Sight(position, valid, surprise, spread, recent)


def near(value):
    return pytest.approx(value, rel=1e-9, abs=0.0)


def clip(value):
    return np.clip(value, -CLIP * SPREAD, CLIP * SPREAD)


def test_the_ring_is_asked_at_each_lag_by_itself(ring, asked):
    questions, sight = asked
    sums = ask_ring(Sums.none(LAGS + 2, 1), sight, questions, ring, USUAL).sums[:, :, 0]
    weight = sight.valid / SPREAD**2
    for lag, question in enumerate(questions):
        for row, share in ((0, LITTLE), (2, MUCH)):
            if question is None:
                assert not sums[:, lag].any()
                continue
            left = weight * clip(sight.position - question.still - share * question.asked)
            power = question.size**2 * sum((left @ move) ** 2 for move in ring.moves.T)
            assert sums[row : row + 2, lag] == near([left @ question.asked, power])
    usual = questions[USUAL].asked
    known = clip(sight.surprise + (1 - LITTLE) * usual)
    power = sum((weight * usual) ** 2 * sight.noise)
    assert sums[:2, -2] == near([sum(weight * usual * known), power])
    assert not sums[2:, -2].any()
    assert not sums[:, -1].any()


def test_all_lags_together_have_a_row_of_their_own(ring, asked):
    (question, *_), sight = asked
    heard = 1e-6 * np.random.default_rng(5).standard_normal(N)
    sums = ask_at_any(Sums.none(LAGS + 2, 1), sight, question, heard, ring).sums[:, :, 0]
    left = sight.valid / SPREAD**2 * clip(heard - MUCH * question.asked)
    power = question.size**2 * sum((left @ move) ** 2 for move in ring.moves.T)
    assert sums[2:4, -1] == near([left @ question.asked, power])
    assert not sums[:, :-1].any()


def test_each_device_is_asked_for_its_own_part(ring, asked):
    (now, before, _), sight = asked
    sums = ask_devices(Sums.none(2, N + M), sight, now, before, ring).sums
    for late, question in enumerate((now, before)):
        for bpm in range(N):
            x = question.asked[bpm] if sight.valid[bpm] else 0.0
            besides = sight.position[bpm] - question.still[bpm]
            known = besides if late else sight.surprise[bpm] + x
            left, reach = clip(besides - MUCH * x), question.size**2 * ring.reach[bpm]
            expected = [
                x * clip(known - LITTLE * x),
                x**2 * sight.noise[bpm],
                x * left,
                reach * left**2 * sight.valid[bpm],
                x * clip(MUCH * x),
            ]
            assert sums[:, late, bpm] == near(expected)
    assert not sums[:, 1, N:].any()
    most = CLIP * np.hypot(SPREAD, now.size)
    noise = np.median(np.clip(np.abs(sight.surprise), SPREAD, most) ** 2)

    def loud(value):
        return np.clip(value, -most, most)

    for corrector in range(M):
        apart = ring.apart[corrector]
        telling = sight.valid * (ring.response @ (apart * now.excursion))
        own = ring.response[:, corrector] * sight.recent[corrector]
        unsure = apart[corrector] * noise
        others = sight.recent[corrector] - now.excursion[corrector]
        blurred = others**2 * ring.swing[corrector]
        weight = apart[corrector] * SPREAD**2 / (unsure + blurred) / now.size**2
        little = telling @ loud(sight.surprise + (1 - LITTLE) * own)
        much = telling @ loud(sight.surprise + (1 - MUCH) * own)
        expected = [
            weight * little,
            (weight * now.size) ** 2 * (unsure + LITTLE**2 * blurred),
            weight * much,
            (weight * much) ** 2,
            weight * (telling @ loud(MUCH * own)),
        ]
        assert sums[:, 0, N + corrector] == near(expected)


def test_what_is_said_adds_up_and_one_row_or_device_begins_anew(ring, asked):
    (now, before, _), sight = asked
    once = ask_devices(Sums.none(2, N + M), sight, now, before, ring)
    twice = ask_devices(once, sight, now, before, ring)
    assert twice.sums == near(2.0 * once.sums)
    forgotten = twice.forget(0)
    assert not forgotten.sums[:, 0].any()
    assert np.array_equal(forgotten.sums[:, 1], twice.sums[:, 1])
    which = np.arange(N + M) == 2
    anew = twice.anew(which)
    assert not anew.sums[:, :, 2].any()
    assert np.array_equal(anew.sums[:, :, ~which], twice.sums[:, :, ~which])
