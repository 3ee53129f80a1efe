"""What follows of what is owed: who has no say, when the loop waits, how loud it asks."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.safety.answers.answering import PATIENCE, interrupted, look, note
from orbitfb.safety.answers.expectation import Expectation, Owed
from orbitfb.safety.answers.findings import Seen as Orbit
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


def seen(memory, **state):
    valid, ring = np.ones(N, bool), memory.ring
    return Orbit(
        np.zeros(N), valid, ring.response, ring.movable, state["closed"], 1.0, state["held"]
    )


def test_what_a_loop_has_asked_for_is_owed_while_it_is_held(memory):
    memory = owing(memory, [3])
    _, held = look(seen(memory, closed=False, held=True), memory, SETTINGS)
    assert held.owed.bpms[3] == MUCH
    assert held.session is memory.session  # what was heard so far still counts
    _, after = look(seen(memory, closed=False, held=False), memory, SETTINGS)
    assert after.owed is None


def test_a_change_whose_answer_comes_while_the_loop_is_held_is_answered(memory):
    step = np.full(N, 50e-6)
    memory = replace(note(memory, Sent(np.ones(M), step)), session=None)
    _, after = look(replace(seen(memory, closed=False, held=True), position=step), memory, SETTINGS)
    assert not after.owed.ring.any()
    assert not after.sent[0].moved.any()  # a held loop sends nothing


def test_once_it_waits_for_one_it_waits_until_that_has_answered(memory):
    memory = owing(memory, [3])
    owed = replace(memory.owed, bpms=1.2 * memory.owed.bpms)
    _, after = look(seen(memory, closed=True, held=False), replace(memory, owed=owed), SETTINGS)
    less = replace(after, owed=replace(owed, bpms=0.9 * memory.owed.bpms))
    assert less.waits(SETTINGS)
    assert not replace(less, session=replace(less.session, stopped=False)).waits(SETTINGS)


def test_who_cannot_be_heard_for_long_is_left_out_if_the_ring_answers(memory):
    owed = Owed.nothing(N, M)
    owed.bpms[3] = 2.5 * SETTINGS.answer_reach
    session = replace(memory.session, stopped=True, waited=PATIENCE)
    memory = replace(memory, owed=owed, session=session)
    found, after = look(seen(memory, closed=True, held=False), memory, SETTINGS)
    assert found.bpms == (3,)
    assert not found.ring
    assert after.session.waited == 0
