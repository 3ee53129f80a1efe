"""The loop believes no orbit that does not answer it.

What the loop asks for is added up until the ring, the BPM or the corrector is seen to answer. When
that comes to `answer_reach`, or nothing was seen to answer for long, the loop asks: it adds small
random excursions (`questions`) to what it sends until whoever is in doubt has answered, the louder
the more is at stake. A ring that does not answer trips; a BPM or a corrector that does not is left
out by name. While the ring as a whole owes as much the loop corrects nothing; a few devices that
owe too much have no say, it corrects without them.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.core.values import replace
from orbitfb.safety.answers.evidence import Test, ask_at_any, ask_devices, ask_ring
from orbitfb.safety.answers.expectation import Expectation, Owed, shown
from orbitfb.safety.answers.findings import NOTHING, Found, Seen
from orbitfb.safety.answers.owing import (
    HALF,
    LAGS,
    MOST,
    SETTLED,
    STAKE,
    Answering,
    Sent,
    Session,
    rms,
)
from orbitfb.safety.answers.questions import Ring, Rings, Sight
from orbitfb.safety.interlocks import InterlockSettings

ANSWERED = 4.0
"""z from which a device answers: by chance once in exp(4² / 2) = 3,000 questions at most, and then
it is asked again."""

SILENT = 5.0
"""z from which one does not. A device that gives 60 % of an answer is wronged once in exp(5² / 2) =
270,000 sessions at most; one that gives 80 % or more needs 6 to 8 times its noise for it."""

TOLD = 2 * SILENT
"""Evidence z that there would be against a device by now if it did not answer, from which less than
half of it means that it answers, if by a part."""

SUSPECT = 3.0
"""z from which a corrector is suspected: BPMs beside it seem silent too, so that they wait."""

PATIENCE = 300
"""Orbits of only asking after which no answer counts as none: a hundred times what a ring needs
whose noise is as large as the question, and twice what one device needs."""


def look(
    seen: Seen, memory: Answering, settings: InterlockSettings, rings: Rings | None = None
) -> tuple[Found, Answering]:
    """Compare an orbit with what was asked of it.

    Args:
        seen: The orbit.
        memory: What the last call, or `note`, returned.
        settings: What may be asked for without an answer, and how loud a question may be.
        rings: Remembers what was made of a response; None: it is made anew for another one.
    """
    memory, ring = _prepared(seen, memory, rings or Rings())
    expected = memory.expected
    n, m = len(seen.position), len(seen.response.T)
    valid = seen.valid & np.isfinite(seen.position)
    if expected is None:
        position = np.where(valid, seen.position, 0.0)
        return NOTHING, replace(memory, expected=Expectation.first(position, m))
    came = memory.sent[memory.lag] if len(memory.sent) > memory.lag else None
    came = came or Sent(np.zeros(m), np.zeros(n))
    moved, change = came.moved, came.change
    position = np.where(valid, seen.position, expected.model + moved)
    after = expected.follow(position, moved, change, valid)
    waits = seen.held and memory.owed is not None
    if not (seen.closed or waits) or settings.answer_reach is None:
        idle = replace(memory, expected=after, sent=(), heard=(), owed=None, session=None)
        return NOTHING, replace(idle, since=float("nan"))
    owed = memory.owed
    owed = owed or Owed.nothing(n, m)
    counts = np.concatenate((valid, ring.movable))
    since = seen.time if np.isnan(memory.since) else memory.since
    memory = replace(memory, expected=after, owed=owed.paid(False, ~counts), since=since)
    step = position - expected.before
    memory = replace(_heed_steps(step, valid, memory, expected, ring, settings), gap=0)
    if waits:
        sent = (Sent(np.zeros(m), np.zeros(n)), *memory.sent[:LAGS])
        return NOTHING, replace(memory, sent=sent, heard=())
    session = memory.session
    if session is None:
        return NOTHING, _begin(memory, ring, valid, seen.time, settings)
    surprise = expected.surprise(position, moved)
    sight = Sight(position, valid, surprise, expected.spread, after.recent)
    questions = tuple(item.question for item in memory.sent)
    if valid.any() and not sight.kicked(questions[: LAGS + 1]):
        memory, over = memory.hear(position)
        whole = ask_ring(session.whole, sight, questions, ring, memory.lag)
        for question, heard in over:
            whole = ask_at_any(whole, sight, question, heard, ring)
        at = [*questions[memory.lag : memory.lag + 2], None, None]
        devices = ask_devices(session.devices, sight, at[0], at[1], ring)
        session = replace(session, whole=whole, devices=devices)
    else:
        memory = replace(memory, heard=())
    return _judge(seen, replace(memory, session=session), session, ring, valid, settings)


def note(memory: Answering, sent: Sent) -> Answering:
    """Remember what was sent after an orbit, zeros if nothing was.

    Args:
        memory: What `look` returned.
        sent: What was sent.
    """
    owed, expected = memory.owed, memory.expected
    if owed is None:  # the loop has just closed
        owed = Owed.nothing(len(sent.moved), len(sent.change))
        memory = replace(memory, start=None if expected is None else expected.before)
    owed = owed.add(sent.moved, sent.change)
    return replace(memory, owed=owed, sent=(sent, *memory.sent[:LAGS]))


def interrupted(memory: Answering, missed: int) -> Answering:
    """Live through orbits that nobody saw: what was sent moved the beam, and stands.

    A question stands until the next change is sent, so that the first orbit that is seen again may
    answer it: with every other orbit missed, a loop that forgot would never hear an answer.

    Args:
        memory: What the last `look` or `note` left.
        missed: Count of the orbits that were missed.
    """
    expected = memory.expected
    if expected is None:
        return memory
    sent = memory.sent
    for _ in range(min(missed, LAGS + 1)):  # then all that was sent has come
        if len(sent) > memory.lag:
            expected = expected.unseen(sent[memory.lag].moved, sent[memory.lag].change)
        sent = (*(item.standing() for item in sent[:1]), *sent)
    return replace(memory, expected=expected, sent=sent, gap=min(missed, LAGS + 1))


def opened(memory: Answering) -> Answering:
    """Believe everybody again: the loop is open."""
    return replace(memory, owed=None, session=None, sent=(), left=None)


def _prepared(seen: Seen, memory: Answering, rings: Rings) -> tuple[Answering, Ring]:
    """Take the response of the policy in force, and the correctors that move."""
    ring = memory.ring
    same = ring is not None and ring.response is seen.response
    if ring is not None and same and np.array_equal(ring.movable, seen.movable):
        return memory, ring
    ring = rings.of(seen.response, seen.movable)
    expected = memory.expected
    if expected is not None and expected.model.shape != seen.position.shape:
        memory = Answering(found=memory.found)
    n, m = len(seen.position), len(seen.response.T)
    session = None
    if memory.session is not None:
        session = memory.session.anew(n, m)
    sent = tuple(replace(item, question=None) for item in memory.sent)
    return replace(memory, ring=ring, session=session, sent=sent, heard=()), ring


def _heed_steps(
    step: Vector,
    valid: Mask,
    memory: Answering,
    expected: Expectation,
    ring: Ring,
    settings: InterlockSettings,
) -> Answering:
    """Strike out what plainly showed in a step of the orbit, whichever change it answers."""
    least, nobody = settings.prediction_floor, np.zeros(len(step) + len(ring.sizes), dtype=np.bool_)
    count = int(np.count_nonzero(valid))
    for lag in range(min(LAGS, len(memory.sent))):
        came = memory.sent[lag : lag + memory.gap + 1]
        moved, change = came[0].moved, came[0].change
        if len(came) > 1:
            moved = np.sum([sent.moved for sent in came], axis=0)
            change = np.sum([sent.change for sent in came], axis=0)
        if float(moved @ moved) < count * least**2:  # none that is too small shows, see `shown`
            continue
        whole, devices = shown(step, moved, change, valid, expected.spread, least, ring)
        if whole and memory.owed is not None:
            devices = devices if lag == memory.lag else nobody
            return replace(memory, owed=memory.owed.paid(whole, devices))
    return memory


def _begin(
    memory: Answering, ring: Ring, valid: Mask, time: float, settings: InterlockSettings
) -> Answering:
    """Ask if somebody owes too much, or nobody was asked for long."""
    owed, expected, reach = memory.owed, memory.expected, settings.answer_reach
    if owed is None or expected is None or reach is None or expected.orbits < SETTLED:
        return memory
    doubted = _doubted(owed, ring, valid, reach).any() or rms(owed.ring) > reach
    if not doubted and time - memory.since < settings.answer_after:
        return memory
    if settings.answer_question == 0 or not ring.movable.any():
        return memory
    return replace(memory, session=Session.begin(*ring.response.shape, doubted=bool(doubted)))


def _judge(
    seen: Seen,
    memory: Answering,
    session: Session,
    ring: Ring,
    valid: Mask,
    settings: InterlockSettings,
) -> tuple[Found, Answering]:
    """Say what the answers mean: of the ring first, then of correctors, then of BPMs."""
    n, m = ring.response.shape
    owed, reach = memory.owed, settings.answer_reach
    if owed is None or reach is None:
        return NOTHING, memory
    whole, nobody = session.whole.first(LAGS), np.zeros(n + m, dtype=np.bool_)
    waited = session.waited + 1 if memory.waits(settings) else 0
    late = _doubted(owed, ring, valid, reach) & session.answered & (waited > PATIENCE)
    if session.silence >= SILENT or (waited > PATIENCE and not late.any()):
        asked = rms(owed.ring)
        reason = (
            f"the orbit does not answer the setpoints: {asked * 1e6:.3g} µm rms were asked for "
            "since it last did; BPMs that do not see the beam, power supplies that do not move it, "
            "or a response matrix of another ring, sign or order: look at them before the loop is "
            "reset"
        )
        after = replace(memory, session=None, owed=Owed.nothing(n, m), found=memory.found + 1)
        return Found(ring=reason), after
    lag, since, answered, devices = memory.lag, memory.since, session.answered, session.devices
    if float(session.whole.sure[0]) >= ANSWERED:
        owed, since = owed.paid(True, nobody), seen.time
        session = replace(session, whole=session.whole.forget(LAGS))
    if float(whole.sure[0]) >= ANSWERED:
        if whole.lag != lag:
            lag, devices = whole.lag, Test.none(2, n + m)
        session, answered = replace(session, whole=Test.none(LAGS + 2, 1)), True
    told = devices.told
    sure = (devices.sure >= ANSWERED) | ((told >= TOLD) & (devices.doubt < 0.5 * told))
    owed, devices = owed.paid(False, sure), devices.anew(sure)
    waited, orbits = 0 if late.any() else waited, session.orbits + 1
    session = replace(session, devices=devices, answered=answered, waited=waited, orbits=orbits)
    least = (STAKE if session.stopped else MOST) * reach
    session = replace(session, stopped=memory.overdue(owed) > least)
    after = replace(memory, session=session, owed=owed, lag=lag, since=since)
    counts = np.concatenate((valid, ring.movable))
    silent = late | (counts & (devices.doubt >= SILENT) & answered)
    correctors, bpms = np.flatnonzero(silent[n:]), np.flatnonzero(silent[:n])
    if correctors.size or (bpms.size and float(devices.doubt[n:].max(initial=0.0)) >= SUSPECT):
        bpms = bpms[:0]
    if correctors.size or bpms.size:
        left = memory.left
        if bpms.size:
            left = np.zeros(n, dtype=np.bool_) if left is None else left.copy()
            left[bpms] = True
        after = replace(
            after, session=session.without(silent, n), left=left, found=memory.found + 1
        )
        return Found("", tuple(bpms.tolist()), tuple(correctors.tolist())), after
    enough = HALF * reach if session.doubted else reach
    over = answered and not _doubted(owed, ring, valid, enough).any()
    return NOTHING, replace(after, session=None) if over else after


def _doubted(owed: Owed, ring: Ring, valid: Mask, reach: float) -> Mask:
    """Find who owes more than a reach [m], shape (n + m,)."""
    return (owed.sizes(ring) > reach) & np.concatenate((valid, ring.movable))
