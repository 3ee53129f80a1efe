"""Whether causes act as their laws say: what another law of the same devices could gain.

The nearest effect of the library takes over most of what an unknown effect of the same device
does; what is left of it is too little for a test over all devices and lags, but not for one at
the places of the cause: does what is left go with another course there (a change of the setpoint
a tick later, its square, every other tick, growing with time …)? Each course is tried by itself,
and pays for the choice.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.special import expit

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, columns_of, explain, restored
from orbitfb.diagnose.noise_departure import noise_laws
from orbitfb.diagnose.rhythm import rhythm
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

IDEAL = 0.1
"""Share of an effect's gain that nature's departure from a law of the library may be worth."""
STAND_IN = 0.5
"""The same share beyond which the law is not that of the effect at all."""
OUTSIDE = 0.15
"""Share of the causes of gaps that are in no library, before the data: one in seven."""
UNTOLD = 0.6
"""Share of these that none of the courses here tells from the library's nearest: six of nine sealed
ones that somebody who knew them would have seen (`fast`, seeds 4 and 6, first 60)."""
_OCCAM = 2.0
"""What the size of a course costs [nats]."""
_ALIKE = 0.9
"""Cosine of a source's orbit with that of a corrector that may be what makes it."""
_COST = 5.0
"""What a course has to gain to be seen at all: its size, and the choice among all [nats]."""
_MEMORIES = (5.0, 20.0, 80.0, 300.0)
"""Time constants of slow followers [ticks]."""
_PARTS = (5, 20, 80)
"""Rows of the parts of a record in which a cause may have a strength of its own."""
_STRENGTHS = np.array([0.1, 0.3, 1.0])
"""Scatter of it, over the fitted one."""
_RANK = 2
_SMALL = 0.05
"""Part of an orbit's largest shape below which another one is not looked at."""
_TINY = 1e-300
_COLOURS = (1, 2)
"""Ticks over which noise that is not quite as the floor says echoes at a BPM."""


@dataclass(frozen=True, slots=True)
class Departure:
    """The course that a cause's law lacks most.

    Args:
        course: In words; empty where there is none.
        nats: What it gains, less the price of the choice; at least 0 [nats].
        gain: Of the cause itself [nats].
        excused: Share of that by which nature may depart so from a law that is right.
    """

    course: str
    nats: float
    gain: float
    excused: float = IDEAL

    @property
    def chance(self) -> float:
        """Probability that the law is the cause's own, given that it is the best of the library."""
        gain = max(self.gain, 0.0)
        right = float(expit(self.excused * gain - self.nats)) if self.nats > 0.0 else 1.0
        missed = min(1.0, UNTOLD + _COST / gain) if gain > 0.0 else 1.0
        return right * (1.0 - OUTSIDE * missed)

    @property
    def stand_in(self) -> bool:
        """Whether the cause only stands for another effect of the same devices."""
        return self.nats > STAND_IN * self.gain


def departure(bench: Bench, cause: Cause, gain: float, before: Bench | None = None) -> Departure:
    """Look for a course of a cause's devices that its law does not have.

    Args:
        bench: The record under all causes.
        cause: One of them.
        gain: Of the cause [nats].
        before: The record under the causes before it, for one whose strikes were taken out; None
            where there were none.

    Returns:
        The best course; one that gains nothing where the law leaves nothing.
    """
    if isinstance(cause.kind, LatentKind | NoiseKind):
        if (clock := 0.0 if before is None else rhythm(before, cause)) > 0.0:
            return Departure("by a clock, always after as many ticks", clock, gain, 0.0)
        course, nats = max(noise_laws(bench, cause), key=lambda law: law[1], default=("", 0.0))
        return Departure(course, nats, gain) if nats > 0.0 else Departure("", 0.0, gain)
    echoes = _echoes(bench, cause)
    best, top, tried = "", 0.0, 0
    for name, trial in _trials(bench, cause):
        change = bench.floor.whiten(trial, bench.record.starts)
        height = _gain(bench, change, echoes)
        tried += 1
        if height > top:
            best, top = name, height
    nats = top - float(np.log(tried)) - _OCCAM
    uneven = _uneven(bench, cause)
    if uneven > max(nats, 0.0):
        best, nats = "with a strength that comes and goes", uneven
    return Departure(best, nats, gain) if nats > 0.0 else Departure("", 0.0, gain)


def _uneven(bench: Bench, cause: Cause) -> float:
    """What a strength of a cause that is drawn anew for every part of a record gains [nats].

    The likelihood ratio of a part whose strength is normal about the fitted one. What a BPM does
    to its noise goes with the noise itself: of BPMs it tells nothing.
    """
    if isinstance(cause.kind, SensorKind) or cause.kind.target == "bpm":
        return 0.0
    others = [one for one in bench.causes if one is not cause]
    without = Bench(bench.record, others, bench.floor, bench.floor.modes)
    change = without.residual(())[0] - without.residual((cause,))[0]
    score, info = np.sum(change * bench.white, axis=1), np.sum(change**2, axis=1)
    heights: list[float] = []
    for rows in _PARTS:
        begins = np.arange(0, len(score), rows)
        pull, known = np.add.reduceat(score, begins), np.add.reduceat(info, begins)
        for variance in _STRENGTHS**2:
            spread = 1.0 + variance * known
            heights.append(float(np.sum(variance * pull**2 / spread - np.log(spread))))
    return 0.5 * max(heights) - float(np.log(len(heights))) - _OCCAM


def _trials(bench: Bench, cause: Cause) -> Iterator[tuple[str, Matrix]]:
    """Courses in words, and what they add to the prediction, each of shape (N, n)."""
    for patterns, course in _drives(bench, cause):
        for name, trial in (*_courses(course), *_with_others(bench, course)):
            yield name, trial @ patterns.T
    yield from _heard(bench, cause)


def _heard(bench: Bench, cause: Cause) -> Iterator[tuple[str, Matrix]]:
    """What a single BPM may hear of the others of its cell and plane, at once or slowly."""
    if not isinstance(cause.kind, SensorKind) or len(cause.places) != 1:
        return
    bpms, own = bench.record.layout.bpms, cause.places[0]
    for other in range(len(bpms)):
        alike = bpms.cells[other] == bpms.cells[own] and bpms.planes[other] == bpms.planes[own]
        if other == own or not alike or not bpms.cells[own]:
            continue
        course = bench.orbit[:, other] - bench.orbit[:, other].mean()
        for memory in (0.0, *_MEMORIES[:2]):
            kept = float(np.exp(-1.0 / memory)) if memory else 0.0
            told = np.zeros_like(bench.orbit)
            told[:, own] = lfilter([1.0 - kept], [1.0, -kept], course)
            slowly = f", slowly, over {memory:.0f} ticks" if memory else ""
            yield f"as what {bpms.label(other)} reads{slowly}", told


def _drives(bench: Bench, cause: Cause) -> Iterator[tuple[Matrix, Matrix]]:
    """What drives a cause's devices; where a source is like a corrector, also what drives that."""
    patterns, course = _driven(bench, cause)
    yield patterns, course
    if not isinstance(cause.kind, SourceKind) or cause.kind.target != "source":
        return
    response = bench.record.layout.response
    modal = bench.floor.modes.directions.T @ np.column_stack([patterns[:, :1], response])
    modal /= np.sqrt(bench.floor.innovation_variance)[:, None]
    modal /= np.maximum(np.linalg.norm(modal, axis=0), _TINY)
    alike = np.abs(modal[:, 1:].T @ modal[:, 0])
    nearest = int(np.argmax(alike))
    if alike[nearest] > _ALIKE:
        setpoints = bench.record.setpoints[:, [nearest]]
        yield response[:, [nearest]], setpoints - setpoints[:1]


def _with_others(bench: Bench, course: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Courses that go with another channel of the record, such as the stored current."""
    for name, channel in bench.record.auxiliary.items():
        size = float(np.std(channel))
        if np.isfinite(size) and size > 0.0:
            yield (
                f"in proportion, the more so with {name}",
                course * ((channel - channel.mean()) / size)[:, None],
            )


def _driven(bench: Bench, cause: Cause) -> tuple[Matrix, Matrix]:
    """Orbits (n, P) that a cause's devices make, and what drives them (N, P)."""
    record, kind = bench.record, cause.kind
    layout = record.layout
    if kind.target == "corrector" or isinstance(kind, ActuatorKind):
        columns = _columns(bench, cause, record.setpoints.shape[1])
        course = record.setpoints[:, columns]
        return layout.response[:, columns], course - course[:1]
    if isinstance(kind, SensorKind | PairKind):
        columns = _columns(bench, cause, record.readings.shape[1])
        course = bench.orbit[:, columns]
        return np.eye(record.readings.shape[1])[:, columns], course - course.mean(axis=0)
    others = [one for one in bench.causes if one is not cause]
    without = explain(record, others, bench.orbit).left
    change = without - explain(record, (*others, cause), bench.orbit).left
    courses, heights, patterns = np.linalg.svd(change, full_matrices=False)
    rank = min(max(int(np.sum(heights > _SMALL * heights[0])), 1), _RANK)
    return patterns[:rank].T, courses[:, :rank] * heights[:rank]


def _columns(bench: Bench, cause: Cause, count: int) -> list[int]:
    kind = cause.kind
    if isinstance(kind, PairKind):
        pairs = kind.pairs(bench.record.layout)[list(cause.places)]
        return [int(column) for column in np.unique(pairs)]
    return columns_of(cause, count)


def _courses(course: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Courses that a law may have, in words, each of the shape of what drives it (N, P)."""
    rows = len(course)
    time = np.linspace(-1.0, 1.0, rows)[:, None]
    other = ((-1.0) ** np.arange(rows))[:, None]
    size = np.sqrt(np.mean(course**2, axis=0)) + _TINY
    step = np.diff(course, axis=0, prepend=course[:1])
    usual = np.sqrt(np.mean(step**2, axis=0)) + _TINY
    yield "in proportion", course
    yield "as the last change", step
    for late in (1, 2, 3):
        yield f"as the change {late + 1} ticks ago", _later(step, late)
    for memory in _MEMORIES:
        kept = float(np.exp(-1.0 / memory))
        slow = np.asarray(lfilter([1.0 - kept], [1.0, -kept], course, axis=0), dtype=np.float64)
        yield f"slowly, over {memory:.0f} ticks", slow
    yield "as the square", course**2 / size
    yield "as the cube", course**3 / size**2
    away = np.abs(course - course[:1])
    yield "more than in proportion to the way from where it began", course * away / size
    yield "as the sum of all before", np.cumsum(course - course[:1], axis=0) / rows
    yield "as the change without its sign", np.abs(step)
    yield "more than in proportion to the change", step * np.abs(step) / usual
    yield "only when the direction turns", step * (step * _later(step, 1) < 0.0)
    yield "as all that went up", np.cumsum(np.maximum(step, 0.0), axis=0)
    yield "in proportion, growing with time", course * time
    yield "in proportion, in the second half", course * (time > 0.0)
    yield "as the change, growing with time", step * time
    yield "in proportion, every other tick", course * other
    yield "as the change, every other tick", step * other
    yield "steadily with time", np.repeat(time, course.shape[1], axis=1) * size
    together = np.mean(np.abs(course) / size, axis=1, keepdims=True)
    yield "the less, the more all are driven", course * together


def _later(course: Matrix, ticks: int) -> Matrix:
    return np.vstack([np.zeros((ticks, course.shape[1])), course[:-ticks]])


def _echoes(bench: Bench, cause: Cause) -> Matrix:
    """Orthonormal echoes of the noise at a cause's BPMs, shape (E, N · n)."""
    if not isinstance(cause.kind, SensorKind) and cause.kind.target != "bpm":
        return np.zeros((0, bench.white.size))
    columns = _columns(bench, cause, bench.white.shape[1])
    noise = restored(bench.record, bench.causes)[0] - bench.orbit
    found: list[Vector] = []
    for late in _COLOURS:
        echo = np.zeros_like(noise)
        echo[late:, columns] = noise[:-late, columns]
        found.append(bench.floor.whiten(echo, bench.record.starts).ravel())
    return np.linalg.qr(np.array(found).T)[0].T


def _gain(bench: Bench, change: Matrix, echoes: Matrix) -> float:
    """Gain of a change of best size, beside echoes of best size [nats]."""
    moved = change.ravel()
    moved = moved - (echoes @ moved) @ echoes
    known = float(moved @ moved)
    pull = float(moved @ bench.white.ravel())
    return 0.5 * pull**2 / known if known > 0.0 else 0.0
