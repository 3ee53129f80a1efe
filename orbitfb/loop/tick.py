"""One tick as functions of values: check, supervise, decide. Limiting is in `safety.limits`."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.core.values import replace
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.states import Event
from orbitfb.safety import interlocks, watch
from orbitfb.safety.bpms import Flaw, Flaws, bpm_quota, screen
from orbitfb.safety.correctors import follow
from orbitfb.safety.prediction import answered, idle
from orbitfb.safety.verdict import Action, Verdict, worst


@dataclass(frozen=True)
class Checked:
    """An orbit that was looked at.

    Args:
        error: Orbit − reference, shape (n,) [m]; 0 where not valid.
        valid: BPMs that count, shape (n,).
        rms: Of the error over the valid BPMs [m]; NaN when there are none.
        off: Correctors whose readback is not at their setpoint now, shape (m,).
        verdict: The gravest that the interlocks say.
        sound: The gravest of those that do not look at the size of the error.
        memory: What they remember of this tick.
    """

    error: Vector
    valid: Mask
    rms: float
    off: Mask
    verdict: Verdict
    sound: Verdict
    memory: LoopMemory


def screened(
    reading: Reading, memory: LoopMemory, rules: Rules
) -> tuple[Reading, Flaws, LoopMemory]:
    """Let BPMs whose readings must not be believed be not valid.

    Args:
        reading: From the machine.
        memory: What the last tick left.
        rules: Settings and reference.

    Returns:
        The reading, what is wrong with each BPM, shape (n,), and the new memory.
    """
    orbit = reading.orbit
    flaws, bpms = screen(
        orbit.position,
        orbit.position - rules.reference,
        orbit.valid,
        memory.bpms,
        rules.interlocks,
        tuple(rules.channels.bpm_parts.values()),
        memory.state in (LoopState.CLOSED, LoopState.HELD),
    )
    if (left := memory.answering.left) is not None:
        flaws[left & (flaws == Flaw.NONE)] = Flaw.SILENT
    if flaws.any():
        reading = replace(reading, orbit=replace(orbit, valid=orbit.valid & (flaws == 0)))
    return reading, flaws, replace(memory, bpms=bpms)


def check(
    reading: Reading,
    memory: LoopMemory,
    rules: Rules,
    flaws: Flaws | None = None,
    movable: Mask | None = None,
    leaves_out: bool = False,
) -> Checked:
    """Form the orbit error and ask every interlock.

    Args:
        reading: From the machine, screened.
        memory: What the last tick left.
        rules: Settings and reference.
        flaws: What is wrong with each BPM, shape (n,).
        movable: Correctors that the policy moves, shape (m,); None: all.
        leaves_out: Whether correctors that do not follow can be left out.
    """
    settings, names = rules.interlocks, rules.channels
    closed = memory.state is LoopState.CLOSED
    valid = reading.orbit.valid & np.isfinite(reading.orbit.position)
    error = reading.orbit.position - rules.reference
    if not valid.all():
        error = np.where(valid, error, 0.0)
    rms, largest = _size(error, int(np.count_nonzero(valid)))
    fresh, last = watch.repeated(reading.orbit, valid, memory.last, settings)
    planes, left_out = tuple(names.bpm_parts.values()), reading.left_out
    quota = bpm_quota(valid, settings, names.bpms, rules.counting, flaws, planes, left_out)
    unknown = Action.TRIP if closed else Action.HOLD
    active = closed or memory.state is LoopState.HELD
    before = memory.current if active else float("nan")
    now = reading.auxiliary.get(settings.current_channel, float("nan"))
    why = reading.unknown
    current = interlocks.stored_current(reading.auxiliary, settings, unknown, before, why)
    verdicts: list[Verdict] = []
    growth, answers, rise = memory.growth, memory.answers, memory.rise
    if fresh.may_act and quota.may_act:
        verdicts.append(interlocks.orbit_distortion(rms, largest, settings))
        fast, rise = watch.rising(rms, reading.received, rise, settings)
        if closed:
            verdicts.append(fast)
            diverging, growth = watch.divergence(rms, growth, settings)
            answering, answers = answered(reading.orbit.position, valid, rms, answers, settings)
            verdicts += [answering, diverging]
    if not closed:
        answers = idle(reading.orbit.position, valid, answers)
    off = interlocks.not_following(reading.readback, memory.recent, settings)
    told, refusing = _refusing(reading, memory, movable)
    away = reading.away
    if away is not None:
        off = off | away
    following = follow(
        off if movable is None else off & movable,
        reading.readback,
        memory.off,
        memory.lost,
        settings,
        names.correctors,
        acting=closed or (leaves_out and memory.state is LoopState.HELD),
        held=memory.state is LoopState.HELD,
        leaves_out=leaves_out,
        away=away if away is None or movable is None else away & movable,
        sure=memory.sure,
        told=told,
        refusing=refusing,
    )
    causes = {index: why for index, why in told.items() if following.lost[index]}
    beside = interlocks.fast_feedback(reading.auxiliary, settings, why)
    sound = worst(fresh, quota, current, beside, following.verdict)
    after = replace(
        memory,
        last=last,
        growth=growth,
        answers=answers,
        rise=rise,
        off=following.counts,
        lost=following.lost,
        sure=following.sure,
        # Not known for a while, as after a restart of the IOC: compared with what it was before.
        current=before if np.isnan(now) else now,
        away=away,
        refusals=replace(memory.refusals, causes=causes, found={}),
    )
    return Checked(error, valid, rms, off, worst(sound, *verdicts), sound, after)


def _refusing(
    reading: Reading, memory: LoopMemory, movable: Mask | None
) -> tuple[dict[int, str], Mask]:
    """Collect what is known of correctors that do not take puts, and which they are, shape (m,)."""
    found = {**reading.refused, **memory.refusals.found}
    mask = np.zeros(memory.lost.shape, dtype=np.bool_)
    mask[list(found)] = True
    return {**memory.refusals.causes, **found}, mask if movable is None else mask & movable


def worse(checked: Checked, verdict: Verdict) -> Checked:
    """Take one more verdict into account, if it is graver."""
    if verdict.action <= checked.verdict.action:
        return checked
    return replace(checked, verdict=verdict, sound=worst(checked.sound, verdict))


def _size(error: Vector, count: int) -> tuple[float, float]:
    """Give rms and largest |error| [m], the invalid ones being zeros."""
    if count == 0:
        return float("nan"), float("nan")
    return float(np.sqrt(error @ error / count)), float(np.abs(error).max())


@dataclass(frozen=True, slots=True)
class Happening:
    """What an orbit, or its absence, means for the state.

    Args:
        event: For the state table; None when nothing happens.
        reason: Why.
    """

    event: Event | None
    reason: str


def supervise(memory: LoopMemory, verdict: Verdict, now: float, loop: LoopSettings) -> Happening:
    """Say what a verdict does to the state.

    Args:
        memory: After the check; `good` counts the good orbits before this one.
        verdict: Of the interlocks.
        now: Monotonic [s].
        loop: Pacing and holding.
    """
    if verdict.action is Action.TRIP:
        return Happening(Event.TRIP, verdict.reason)
    if memory.state is LoopState.HELD:
        if verdict.may_act:
            recovered = memory.recloses and memory.good + 1 >= loop.proving
            return Happening(Event.RECOVERED if recovered else None, "")
        return too_long(memory, verdict.reason, now, loop)
    if verdict.action is Action.HOLD:
        return Happening(Event.HOLD, verdict.reason)
    if verdict.action is Action.SKIP and now - memory.fresh >= loop.patience:
        return Happening(Event.ORBIT_MISSING, verdict.reason)
    return Happening(None, verdict.reason)


def too_long(memory: LoopMemory, reason: str, now: float, loop: LoopSettings) -> Happening:
    """Say whether a held loop has waited long enough to trip.

    Args:
        memory: Of a loop that is HELD.
        reason: What is wrong now.
        now: Monotonic [s].
        loop: Holding.
    """
    held = now - memory.since
    if loop.trip_after is not None and held >= loop.trip_after:
        return Happening(Event.HELD_TOO_LONG, f"held for {held:.1f} s: {reason}")
    return Happening(None, reason)


def decide(
    policy: Policy, checked: Checked, policy_state: object, correctors: int
) -> tuple[Vector, object]:
    """Ask the policy.

    Args:
        policy: In force.
        checked: The orbit error and what of it counts.
        policy_state: What it carries.
        correctors: m.

    Returns:
        The change of setpoints, shape (m,) [A], and the policy's new state.

    Raises:
        ValueError: The policy returned another shape.
    """
    change, after = policy.act(checked.error, checked.valid, policy_state)
    if change.shape != (correctors,):
        raise ValueError(
            f"policy {policy.policy_id} returned a change of shape {change.shape} "
            f"for {correctors} correctors"
        )
    return change, after


def ramp_gain(closed_for: float, loop: LoopSettings) -> float:
    """Give the share of the gain at a time after closing, 0 to 1.

    Args:
        closed_for: Since closing [s]; the tick that closes counts as one period.
        loop: The ramp.
    """
    if loop.ramp == 0:
        return 1.0
    return min(1.0, (max(closed_for, 0.0) + loop.period) / loop.ramp)
