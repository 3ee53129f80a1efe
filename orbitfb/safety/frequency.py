"""When the RF frequency may be stepped, by how much, and when the loop lets go of it.

Horizontal correctors that follow an energy that drifts make a pattern of their own, which changes
the energy too. Its size is E = Σ_j c_j (I_j − I_j0), with c_j the energy per ampere of a corrector
and I_j0 its setpoint once the loop had settled: until then they correct what the loop found. Once
|E| is beyond a dead band, a step of the frequency takes it over. In the same tick the correctors
give back the pattern that moves the orbit as the step does, so that the orbit stays.

What the frequency does is not believed, it is seen. The orbit must answer a step by the dispersion,
beyond what the correctors do. Until three answers are in, a step is just as long as can be told
from the noise. A frequency that goes the wrong way, or none, is found out that way while the energy
has moved by parts in a million.
"""

import math
from dataclasses import dataclass
from statistics import median

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.core.values import replace
from orbitfb.safety.rf_settings import RfSettings

ON_ITS_WAY = "the last step has not arrived yet"
UNKNOWN = "the RF frequency is not known"
ANSWERS = 3
"""Answers of which the median counts: one that a kick of the beam spoils does not decide."""
LEAST_ANSWER, MOST_ANSWER = 0.5, 1.5
"""Part of the predicted answer that counts as one: half way to none, and as far on the other side.
The response of a drifted ring and its dispersion are right within 0.2."""
TELLING = 6.0
"""Standard deviations of its noise that the answer to a step on trial has."""
DRIFT_TICKS = 10
"""Ticks over which the drift of the energy is measured, before there is a step: what a step that
does not arrive makes of the correctors' energy is then a tenth of the step for each tick."""
TO_AND_FRO = 4
"""Steps of alternating signs in a row that are no drift: 1 in 8 is chance, if each is."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """What takes a step of the frequency over.

    Args:
        orbit: What a step does to the orbit, shape (n,) [m/Hz].
        change: Change of setpoints that undoes it, shape (m,) [A/Hz].
        energy: What that changes of the energy of the correctors [1/Hz].
    """

    orbit: Vector
    change: Vector
    energy: float


@dataclass(frozen=True, slots=True)
class SentStep:
    """A step that was sent, and the orbit that it was sent after.

    Args:
        hertz: The step [Hz].
        position: The orbit before, shape (n,) [m].
        valid: BPMs that counted then, shape (n,).
        moved: What the change of the setpoints does to the orbit, shape (n,) [m].
    """

    hertz: float
    position: Vector
    valid: Mask
    moved: Vector


@dataclass(frozen=True, slots=True)
class Frequency:
    """What the loop remembers of the frequency between two ticks.

    Args:
        base: Setpoints once the loop had settled, shape (m,) [A]; None: it has not yet.
        home: Frequency when it was closed [Hz]; NaN: not known.
        asked: What was put last [Hz]; NaN: nothing was.
        since: When, monotonic [s].
        sent: A step that the next orbit answers.
        shares: Part of its predicted answer that each of the last steps had.
        steps: The last steps [Hz].
        stopped: Why the loop has let go of the frequency; empty: it has not.
        waits: Why there is no step just now; empty: nothing stands in the way.
        energy: Relative energy that the correctors make [1]; NaN: not known.
        energies: The same at the last ticks, as if the steps since then had been made before [1].
        count: Steps since the loop was built.
    """

    base: Vector | None = None
    home: float = math.nan
    asked: float = math.nan
    since: float = -math.inf
    sent: SentStep | None = None
    shares: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    stopped: str = ""
    waits: str = ""
    energy: float = math.nan
    energies: tuple[float, ...] = ()
    count: int = 0

    @property
    def drift(self) -> float:
        """Relative energy per tick that the correctors follow [1]; 0: not known."""
        here = self.energies
        return (here[-1] - here[0]) / (len(here) - 1) if len(here) > DRIFT_TICKS else 0.0

    @property
    def aim(self) -> float:
        """Where the frequency is to be [Hz]; NaN: not known."""
        return self.asked if math.isfinite(self.asked) else self.home


def column_fault(ratio: float) -> str:
    """Say why an RF column that was identified is not believed; empty: it is.

    Args:
        ratio: Its size over that of the dispersion of the places table [1].
    """
    if LEAST_ANSWER <= ratio <= MOST_ANSWER:
        return ""
    if ratio <= 0.0:
        wrong = "of the wrong sign"
    else:
        wrong = "far too small" if ratio < 1.0 else "far too large"
    return (
        f"it is {wrong}, {ratio:.2g} of what the dispersion of the places table says; from "
        f"{LEAST_ANSWER:g} to {MOST_ANSWER:g} is believed"
    )


def noted(memory: Frequency, energy: float) -> Frequency:
    """Note the energy that the correctors make at a tick.

    Args:
        memory: So far.
        energy: [1].
    """
    energies = (*memory.energies, energy)[-DRIFT_TICKS - 1 :]
    return replace(memory, energy=energy, energies=energies)


def closed(memory: Frequency) -> Frequency:
    """Begin anew: an operator has closed the loop, or wants the frequency to follow again."""
    return Frequency(count=memory.count)


def compare(
    memory: Frequency, setpoint: float, readback: float | None, now: float, settings: RfSettings
) -> Frequency:
    """See whether the frequency is where it was put.

    Args:
        memory: So far.
        setpoint: That the machine states [Hz]; NaN: not known.
        readback: [Hz]; NaN: not known; None: there is none.
        now: Monotonic [s].
        settings: Tolerance.
    """
    aim = memory.aim
    if memory.stopped or math.isnan(aim):
        return memory
    if not math.isfinite(setpoint) or (readback is not None and not math.isfinite(readback)):
        return replace(memory, waits=UNKNOWN)
    elsewhere = abs(setpoint - aim) > settings.tolerance
    behind = readback is not None and abs(readback - aim) > settings.tolerance
    if not elsewhere and not behind:
        return replace(memory, waits="")
    if now - memory.since < settings.settle:
        return replace(memory, waits=ON_ITS_WAY)
    if elsewhere:
        return replace(
            memory,
            stopped=f"the RF setpoint is {setpoint:.3f} Hz, but the loop has it at {aim:.3f} Hz: "
            f"somebody else sets {settings.setpoint_pv}, or it does not take puts",
        )
    return replace(
        memory,
        stopped=f"the RF does not follow: {settings.readback_pv} reads {readback:.3f} Hz, though "
        f"it was put to {aim:.3f} Hz more than {settings.settle:g} s ago",
    )


def answer(
    memory: Frequency, position: Vector, valid: Mask, pattern: Pattern, noise: float
) -> Frequency:
    """See whether the orbit has answered the step before it, beside the energy that drifts.

    Args:
        memory: So far.
        position: The orbit, shape (n,) [m].
        valid: BPMs that count, shape (n,).
        pattern: What takes a step over.
        noise: Of one BPM reading, rms [m].
    """
    sent = memory.sent
    if sent is None:
        return memory
    memory = replace(memory, sent=None)
    counts = valid & sent.valid
    column = pattern.orbit[counts]
    power = float(column @ column)
    if power * sent.hertz**2 < 2.0 * (0.5 * TELLING * noise) ** 2:
        return memory  # too short to tell
    moved = (position - sent.position - sent.moved)[counts]
    drifted = memory.drift / pattern.energy  # [Hz per tick]
    share = (float(column @ moved) / power - drifted) / sent.hertz
    shares = (*memory.shares, share)[-ANSWERS:]
    memory = replace(memory, shares=shares)
    if len(shares) < ANSWERS or LEAST_ANSWER <= median(shares) <= MOST_ANSWER:
        return memory
    return replace(
        memory,
        stopped=f"the beam does not answer the RF as the dispersion says: {median(shares):.2g} of "
        f"what was predicted for the last {ANSWERS} steps; the sign or the dispersion is wrong, "
        "the RF acts later than a tick, or not on this beam",
    )


def next_step(
    memory: Frequency,
    pattern: Pattern,
    valid: Mask,
    now: float,
    limits: tuple[float, float],
    noise: float,
    settings: RfSettings,
) -> tuple[float, Frequency]:
    """Decide on a step.

    Args:
        memory: So far, with the energy that the correctors make.
        pattern: What takes a step over.
        valid: BPMs that count, shape (n,).
        now: Monotonic [s].
        limits: Drive limits that the machine states, low and high [Hz]; NaN: none.
        noise: Of one BPM reading, rms [m].
        settings: Dead band and limits.

    Returns:
        The step [Hz], 0: none, and the memory.
    """
    still = memory.stopped or memory.waits or math.isnan(memory.home)
    still = still or len(memory.energies) <= DRIFT_TICKS
    if still or not abs(memory.energy) >= settings.dead_band:
        return 0.0, memory
    if now - memory.since < settings.interval:
        return 0.0, memory
    largest = settings.largest_step
    if len(memory.shares) < ANSWERS:
        column = pattern.orbit[valid]
        size = float(np.sqrt(column @ column))
        largest = min(largest, TELLING * math.sqrt(2.0) * noise / size) if size else 0.0
    wanted = -memory.energy / pattern.energy
    step = math.copysign(min(abs(wanted), largest), wanted)
    aim = memory.aim + step
    low, high = limits
    if aim < low or aim > high:
        told = f"{aim:.3f} Hz is beyond the drive limits of {settings.setpoint_pv}, {low} to {high}"
        return 0.0, replace(memory, stopped=f"{told} Hz")
    if abs(aim - memory.home) > settings.range:
        told = f"{aim:.3f} Hz is {abs(aim - memory.home):.4g} Hz from where the loop was closed"
        return 0.0, replace(memory, stopped=f"{told}; rf.range is {settings.range:g} Hz")
    signs = np.sign([*memory.steps, step])[-TO_AND_FRO:]
    if len(signs) == TO_AND_FRO and (signs[1:] == -signs[:-1]).all():
        told = f"the RF would go to and fro: the last {TO_AND_FRO} steps have alternate signs"
        return 0.0, replace(memory, stopped=f"{told}; widen rf.dead_band, or see the dispersion")
    return step, memory


def stepped(memory: Frequency, hertz: float, now: float, taken: float) -> Frequency:
    """Note a step that was put.

    Args:
        memory: So far.
        hertz: The step [Hz].
        now: Monotonic [s].
        taken: What the change of setpoints with it changes of the correctors' energy [1].
    """
    return replace(
        memory,
        asked=memory.aim + hertz,
        since=now,
        energies=tuple(energy + taken for energy in memory.energies),
        steps=(*memory.steps, hertz)[1 - TO_AND_FRO :],
        count=memory.count + 1,
    )
