"""What follows of what is owed: who has no say, when the loop waits, how loud it asks."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.safety.answers.answering import Seen as Orbit
from orbitfb.safety.answers.answering import interrupted, look, note
from orbitfb.safety.answers.expectation import Expectation, Owed
from orbitfb.safety.answers.owing import FEW, GRACE, Answering, Sent, Session
from orbitfb.safety.answers.questions import Question, Ring
from orbitfb.safety.interlocks import InterlockSettings

N, M = 40, 40
SETTINGS = InterlockSettings()
MUCH = 1.8 * SETTINGS.answer_reach


@pytest.fixture
def memory():
    """A loop that asks, and heard the ring."""
    response = np.random.default_rng(1).standard_normal((N, M)) * 1e-5
    ring = Ring.of(response, np.ones(M, dtype=bool))
    session = replace(Session.begin(N, M), answered=True, orbits=GRACE)
    expected = replace(Expectation.first(np.zeros(N), M), power=np.full(N, 0.2e-6**2))
    return Answering(ring, expected, owed=Owed.nothing(N, M), session=session)


def owing(memory, bpms):
    owed = Owed.nothing(N, M)
    owed.bpms[bpms] = MUCH
    return replace(memory, owed=owed)


def test_a_few_that_owe_too_much_have_no_say_and_the_loop_goes_on(memory):
    memory = owing(memory, [3])
    assert np.flatnonzero(memory.doubted(SETTINGS)).tolist() == [3]
    assert not memory.waits(SETTINGS)


def test_if_many_owe_too_much_the_loop_waits(memory):
    memory = owing(memory, range(int(FEW * (N + M)) + 1))
    assert memory.doubted(SETTINGS) is None
    assert memory.waits(SETTINGS)


def test_for_one_that_owes_more_and_more_the_loop_waits(memory):
    memory = owing(memory, [3])
    owed = replace(memory.owed, bpms=1.2 * memory.owed.bpms)
    assert replace(memory, owed=owed).waits(SETTINGS)


def test_a_kick_is_corrected_before_anybody_is_doubted(memory):
    memory = owing(memory, [3])
    memory = replace(memory, session=replace(memory.session, orbits=GRACE - 1))
    assert memory.doubted(SETTINGS) is None


def test_the_question_is_louder_where_the_orbit_is_bad(memory):
    assert memory.question(SETTINGS) == pytest.approx(0.2e-6)
    assert memory.question(SETTINGS, 30e-6) == pytest.approx(3e-6)
    assert memory.question(SETTINGS, 1e-3) == pytest.approx(5e-6)
    silent = InterlockSettings(answer_question=0.0)
    assert memory.question(silent, 30e-6) == 0


def test_a_question_stands_while_orbits_are_missed(memory):
    asked = Question(1e-6, np.ones(M), np.ones(N), np.zeros(N))
    memory = note(memory, Sent(np.ones(M), np.full(N, 1e-6), asked))
    after = interrupted(memory, 2)
    assert [item.question for item in after.sent] == [asked, asked, asked]
    np.testing.assert_allclose(after.expected.model, 1e-6)  # it moved the beam meanwhile
    assert after.gap == 2


def test_a_step_that_shows_after_missed_orbits_is_an_answer(memory):
    step = np.full(N, 50e-6)
    memory = replace(note(memory, Sent(np.ones(M), step)), session=None)
    assert np.abs(memory.owed.ring).max() > 0
    seen = Orbit(step, np.ones(N, bool), memory.ring.response, memory.ring.movable, True, 1.0)
    _, after = look(seen, interrupted(memory, 1), SETTINGS)
    assert not after.owed.ring.any()
