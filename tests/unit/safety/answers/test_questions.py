"""Questions to a ring: who answers is believed, who does not is told, by numbers alone."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.safety.answers.evidence import Test as Sums
from orbitfb.safety.answers.evidence import ask_at_any, ask_devices, ask_ring
from orbitfb.safety.answers.owing import Answering, Sent, Session
from orbitfb.safety.answers.questions import KEPT, Question, Ring, Rings, Sight

N, M, LAGS = 30, 24, 3
NOISE = SIZE = 0.2e-6
SURE, SILENT = 4.0, 5.0


@pytest.fixture(scope="module")
def ring():
    response = 3e-4 * np.random.default_rng(1).standard_normal((N, M))
    return Ring.of(response, np.ones(M, dtype=np.bool_))


class Bench:
    """A ring that is asked at every orbit and does nothing else.

    Args:
        ring: As it is believed.
        sees: Part that each BPM shows, shape (N,).
        takes: Part that each corrector takes, shape (M,).
        late: Orbits by which it all comes late.
        disturbance: Added to orbit t, shape (N,) [m].
    """

    def __init__(self, ring, sees=1.0, takes=1.0, late=0, disturbance=lambda _: 0.0):
        self.ring, self.sees, self.takes, self.late = ring, sees, takes, late
        self.disturbance = disturbance
        self.random = np.random.default_rng(2)
        self.valid = np.ones(N, dtype=np.bool_)
        self.whole, self.devices = Sums.none(LAGS + 2, 1), Sums.none(2, N + M)
        self.sent, self.orbit = [], 0

    def ask(self, count):
        for _ in range(count):
            signs = 2.0 * self.random.integers(0, 2, self.ring.patterns.shape[1]) - 1.0
            excursion = SIZE * self.ring.patterns @ signs
            asked = self.ring.response @ excursion
            self.sent.insert(0, Question(SIZE, excursion, asked, np.zeros(N)))
            acting = self.sent[self.late].excursion if len(self.sent) > self.late else np.zeros(M)
            position = self.sees * (self.ring.response @ (self.takes * acting))
            position = position + NOISE * self.random.standard_normal(N)
            position = position + self.disturbance(self.orbit)
            spread = np.full(N, 1.1 * NOISE)
            sight = self.sight = Sight(position, self.valid, position - asked, spread, excursion)
            self.whole = ask_ring(self.whole, sight, tuple(self.sent), self.ring, 0)
            before = self.sent[1] if len(self.sent) > 1 else None
            self.devices = ask_devices(self.devices, sight, self.sent[0], before, self.ring)
            self.orbit += 1
        return self

    @property
    def silence(self):
        return float(self.whole.first(LAGS).silence[0])


def test_questions_move_the_orbit_as_much_as_they_say_and_only_by_correctors_that_may(ring):
    movable = np.arange(M) != 7
    some = Ring.of(ring.response, movable)
    assert np.sqrt(np.mean(some.moves**2) * some.moves.shape[1]) == pytest.approx(1.0)
    assert not some.patterns[7].any()
    assert (some.patterns[movable] != 0).any(axis=1).all()


def test_a_ring_that_answers_says_so_at_once_and_all_its_devices_soon(ring):
    bench = Bench(ring).ask(10)
    assert bench.whole.sure[0] >= SURE
    bench.ask(90)
    assert (bench.devices.sure >= SURE).all()
    assert bench.whole.first(LAGS).lag == 0


@pytest.mark.parametrize("seed", range(5))
def test_nobody_who_answers_is_called_silent_whatever_moves_the_orbit(ring, seed):
    random = np.random.default_rng(seed)
    ramp, kick = 2e-6 * random.standard_normal((2, N))
    bench = Bench(ring, disturbance=lambda t: 0.02 * t * ramp + (t > 50) * 20 * kick)
    for _ in range(40):
        bench.ask(5)
        assert bench.silence < SILENT
        assert (bench.devices.doubt < SILENT).all()


def test_a_ring_that_does_not_answer_is_found_out_in_a_few_questions(ring):
    bench = Bench(ring, sees=0.0).ask(40)
    assert bench.silence >= SILENT
    assert bench.whole.sure[0] < SURE


def test_a_ring_that_answers_late_answers(ring):
    bench = Bench(ring, late=1).ask(40)
    first = bench.whole.first(LAGS)
    assert first.sure[0] >= SURE
    assert first.lag == 1
    assert bench.silence < SILENT


def test_a_ring_that_answers_now_in_time_now_late_is_not_silent(ring):
    bench, memory, random = Bench(ring), Answering(), np.random.default_rng(4)
    session = Session.begin(N, M)
    for _ in range(300):
        bench.late = int(random.integers(LAGS))
        bench.ask(1)
        sent = tuple(Sent(q.excursion, q.asked, q) for q in bench.sent[: LAGS + 1])
        memory, over = replace(memory, sent=sent).hear(bench.sight.position)
        for question, heard in over:
            bench.whole = ask_at_any(bench.whole, bench.sight, question, heard, ring)
        session = replace(session, whole=bench.whole)
        assert session.silence < SILENT
    assert bench.silence >= SILENT  # at each lag it is


def test_one_bpm_that_is_blind_is_the_one_that_is_told(ring):
    bench = Bench(ring, sees=np.where(np.arange(N) == 11, 0.0, 1.0)).ask(150)
    assert np.flatnonzero(bench.devices.doubt >= SILENT).tolist() == [11]
    assert np.flatnonzero(bench.devices.sure < SURE).tolist() == [11]


def test_a_large_change_that_a_blind_bpm_does_not_see_says_nothing_for_it(ring):
    sight = Bench(ring).ask(1).sight
    surprise = sight.surprise.copy()
    surprise[11] = -100.0 * NOISE  # what the change should have done there
    sight, asked = replace(sight, surprise=surprise), np.where(np.arange(N) == 11, SIZE, 0.0)
    question = Question(SIZE, np.zeros(M), asked, np.zeros(N))
    none = Sums.none(2, N + M)
    plain = ask_devices(none, replace(sight, surprise=np.zeros(N)), question, None, ring)
    assert ask_devices(none, sight, question, None, ring).told[11] == plain.told[11] > 0.0


def test_one_corrector_that_is_deaf_is_the_one_that_is_told(ring):
    bench = Bench(ring, takes=np.where(np.arange(M) == 5, 0.0, 1.0)).ask(150)
    doubt = bench.devices.doubt[N:]
    assert np.flatnonzero(doubt >= SILENT).tolist() == [5]


def test_half_an_answer_is_known_for_an_answer_before_it_is_for_silence(ring):
    bench = Bench(ring, sees=0.5)
    while bench.whole.first(LAGS).sure[0] < SURE:
        bench.ask(1)
        assert bench.orbit < 200
    assert bench.silence < SILENT


def test_a_bpm_that_does_not_count_says_nothing(ring):
    bench = Bench(ring)
    bench.valid = np.arange(N) != 3
    bench.ask(50)
    assert bench.devices.sure[3] == bench.devices.doubt[3] == 0.0


def test_what_was_said_is_forgotten_where_it_is_asked_anew(ring):
    devices = Bench(ring).ask(30).devices
    anew = devices.anew(np.arange(N + M) == 4)
    assert anew.sure[4] == 0.0
    assert (np.delete(anew.sure, 4) == np.delete(devices.sure, 4)).all()


@pytest.mark.filterwarnings("error")
def test_a_ring_of_which_no_corrector_moves_is_asked_nothing(ring):
    nobody = Ring.of(ring.response, np.zeros(M, dtype=np.bool_))
    assert not nobody.patterns.any()
    assert not nobody.moves.any()
    assert np.isfinite(nobody.apart).all()


def test_a_ring_is_looked_at_once_for_each_choice_of_correctors(ring):
    rings, few = Rings(), ring.movable & (np.arange(M) > 2)
    first, other = rings.of(ring.response, ring.movable), rings.of(ring.response, few)
    assert rings.of(ring.response, ring.movable.copy()) is first
    assert rings.of(ring.response, few) is other is not first
    np.testing.assert_array_equal(other.apart, Ring.of(ring.response, few).apart)
    for _ in range(KEPT):
        assert rings.of(ring.response.copy(), ring.movable) is not first
    assert rings.of(ring.response, ring.movable) is not first  # forgotten
