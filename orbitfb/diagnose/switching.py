"""A source that switches between two states: when it did, found as the states of a hidden chain.

In the sum of the innovations along the source's orbit, each weighed by what it tells, a change of
the state by one shows as a pulse that the filter forgets: e_t = ψ e_{t−1} + s_t − s_{t−1}, times
the strength μ, in unit noise. The states s = ±1 change with probability p per tick, so the
likelihood of a course is known tick by tick; a beam search follows the best ones. What a course
then gains is told by all innovations, not by their sum alone.

A Gaussian walk of the same variance gains far less: it knows neither that the steps are few nor
that they are of one size, up and down by turns (random telegraph signal, S. O. Rice, Bell Syst.
Tech. J. 23 (1944) 282).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.kinds import Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.record import Record

_PLACES = 4
"""Sources whose course is followed."""
_KEPT = 3
_BEAM = 64
"""Courses that are followed at a time."""
_LEAST_SWITCHES = 5
"""Fewer are kicks."""
_PROBABILITIES = (0.003, 0.02, 0.1)
_STRENGTHS = (0.7, 1.0, 1.4)
"""Tried, in units of the typical large step."""
_LARGE = 4.0
"""Steps that count as large, in standard deviations."""
_WORTH = 20.0
"""What large steps must promise for a course to be looked for [nats]."""
_UNEVEN = 0.3
"""Relative scatter of the sizes of steps, beyond their errors, from which they are not alike."""
_WIDTH = 1.645
"""Standard deviations of a 90 % interval."""
_IDEAL = 0.03
"""Share of a kick by which healthy optics change what the BPMs see of it."""
_ERROR = 1.5
"""Error of the size of a step in deviations, with others close by."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """States of a source.

    Args:
        states: ±1, shape (N,).
        evidence: Of the scalar model against no source, all courses of the beam together, less
            the likelihood of this one given its states [nats]: what the choice of states costs.
        likelihood: That likelihood itself [nats].
    """

    states: Vector
    evidence: float
    likelihood: float

    @property
    def switches(self) -> Indices:
        """Rows at which the state changes."""
        return np.flatnonzero(np.diff(self.states)) + 1


def switching_candidates(bench: Bench, kind: NoiseKind) -> list[Candidate]:
    """Find sources that switch to and fro, best first; empty when nothing does.

    Args:
        bench: The record under the causes so far.
        kind: A rare kind whose parameters are kick and probability.
    """
    patterns = kind.patterns(bench.record.layout)
    if not patterns.shape[1]:
        return []
    promise = _promise(bench, patterns)
    found: list[Candidate] = []
    for place in np.argsort(promise)[::-1][:_PLACES]:
        if promise[place] > _WORTH:
            found += _followed(bench, kind, patterns, int(place))
    return sorted(found, key=lambda c: c.gain, reverse=True)[:_KEPT]


def _steps(bench: Bench, patterns: Matrix) -> tuple[Matrix, Vector]:
    """Score of a lasting step at every row in deviations, (N, P), and its information, (P,)."""
    floor = bench.floor
    score = np.cumsum((bench.slope @ patterns)[::-1], axis=0)[::-1]
    gains = floor.gains
    echo = 1.0 / (1.0 - (1.0 - gains) ** 2) / floor.innovation_variance
    info = (floor.modes.directions.T @ patterns).T ** 2 @ echo
    return score / np.sqrt(np.maximum(info, 1e-300)), info


def _promise(bench: Bench, patterns: Matrix) -> Vector:
    """What the large steps at every place would gain, roughly, shape (P,) [nats]."""
    large, _ = _steps(bench, patterns)
    size = np.abs(large)
    top = size >= np.maximum(np.roll(size, 1, axis=0), np.roll(size, -1, axis=0))
    return np.sum(np.where(top & (size > _LARGE), 0.5 * (size**2 - _LARGE**2), 0.0), axis=0)


def _followed(bench: Bench, kind: NoiseKind, patterns: Matrix, place: int) -> Iterator[Candidate]:
    if (found := _seen(bench, patterns[:, place])) is not None:
        course, kick, size = found
        cause = Cause(kind, (place,), _values(kick, course))
        gain = 0.5 * kick**2 * size + course.evidence
        yield Candidate(cause, gain, float(patterns.shape[1]))


def switched(bench: Bench, cause: Cause) -> tuple[Values, dict[str, tuple[float, float]]] | None:
    """State kick and probability by the course that a source took, with their 90 % intervals.

    Args:
        bench: The record under the causes so far.
        cause: A source that switches, with its place.

    Returns:
        None where the record shows no such course: it switches too often to be followed.
    """
    found = _course_of(bench, cause)
    if found is None:
        return None
    course, kick, size, _ = found
    values = _values(kick, course)
    reach = _WIDTH * float(np.hypot(1.0 / np.sqrt(size), _IDEAL * kick))
    often = float(np.exp(_WIDTH / np.sqrt(len(course.switches))))
    rate = values["probability"]
    return values, {
        "kick": (max(kick - reach, 0.0), kick + reach),
        "probability": (rate / often, min(rate * often, 0.5)),
    }


def without_switching(bench: Bench, cause: Cause) -> Record | None:
    """Take the course of a source out of a record; None where it cannot be followed.

    Args:
        bench: The record under the causes so far.
        cause: A source that switches, with its place.
    """
    found = _course_of(bench, cause)
    if found is None:
        return None
    course, kick, _, pattern = found
    moved = kick * course.states[:, None] * pattern
    return replace(bench.record, readings=bench.record.readings - moved)


def states_of(bench: Bench, cause: Cause) -> Vector | None:
    """States ±1 of a source that switches, shape (N,); None where it cannot be followed.

    Args:
        bench: The record under the causes before it.
        cause: The source, with its place.
    """
    found = _course_of(bench, cause)
    return None if found is None else found[0].states


def _course_of(bench: Bench, cause: Cause) -> tuple[Course, float, float, Vector] | None:
    """Course of a source, its kick, the information on that, and its orbit per kick."""
    kind = cause.kind
    if not (isinstance(kind, NoiseKind) and kind.rare and len(cause.places) == 1):
        return None
    pattern = kind.patterns(bench.record.layout)[:, cause.places[0]]
    found = _seen(bench, pattern)
    return None if found is None else (*found, pattern)


def _seen(bench: Bench, pattern: Vector) -> tuple[Course, float, float] | None:
    course = _best_course(bench, pattern)
    if course is None:
        return None
    kick, size, uneven = _judged(bench, pattern, course)
    return (course, kick, size) if uneven <= _UNEVEN and kick > 0.0 else None


def _values(kick: float, course: Course) -> Values:
    return {"kick": kick, "probability": len(course.switches) / len(course.states)}


def _best_course(bench: Bench, pattern: Vector) -> Course | None:
    """Follow a source with several kicks and probabilities; None if it hardly switches."""
    floor = bench.floor
    large, info = _steps(bench, pattern[:, None])
    sizes = np.abs(large[:, 0])
    if not (sizes > _LARGE).any():
        return None
    modal = (floor.modes.directions.T @ pattern) / np.sqrt(floor.innovation_variance)
    weight = float(modal @ modal)
    summed = bench.white @ modal / np.sqrt(weight)
    kept = float(modal**2 @ (1.0 - floor.gains)) / weight
    pulse = 0.5 * float(np.median(sizes[sizes > _LARGE]) * np.sqrt(weight / info[0]))
    probability = np.repeat(_PROBABILITIES, len(_STRENGTHS))
    strength = np.tile(np.array(_STRENGTHS) * pulse, len(_PROBABILITIES))
    courses = follow(summed, strength, kept, probability)
    best = max(courses, key=lambda course: course.evidence + course.likelihood)
    return best if len(best.switches) >= _LEAST_SWITCHES else None


def _judged(bench: Bench, pattern: Vector, course: Course) -> tuple[float, float, float]:
    """Kick of a course, what all innovations know of it, and its steps' relative scatter."""
    white = bench.floor.whiten(course.states[:, None] * pattern, bench.record.starts)
    size = float(np.vdot(white, white))
    large, _ = _steps(bench, pattern[:, None])
    rows = course.switches
    alone = 0.5 * np.diff(course.states)[rows - 1] * large[rows, 0]
    scatter = float(np.sqrt(max(alone.var() - _ERROR**2, 0.0)))
    return (
        float(np.vdot(white, bench.white)) / size,
        size,
        scatter / max(float(alone.mean()), 1e-9),
    )


def follow(summed: Vector, strength: Vector, kept: float, probability: Vector) -> list[Course]:
    """Find the states of hidden chains by a beam search, of S chains at a time.

    Args:
        summed: Innovations along the source in unit noise, shape (N,).
        strength: μ, the pulse that a change of the state by one makes, shape (S,).
        kept: ψ, what is left of a pulse a tick later.
        probability: Of a change from tick to tick, shape (S,).
    """
    chains = len(strength)
    each = np.arange(chains)[:, None]
    stay, change = np.log1p(-probability)[:, None], np.log(probability)[:, None]
    # state, echo, prior and what the rows so far have told, of every course, shape (4, S, courses)
    course = np.zeros((4, chains, 2))
    course[0], course[2] = [1.0, -1.0], np.log(0.5)
    chosen = np.zeros((len(summed), chains, _BEAM), dtype=np.int16)
    sizes = np.empty(len(summed), dtype=np.int16)
    for row, value in enumerate(summed):
        size = sizes[row] = course.shape[2]
        both = np.concatenate([course, course], axis=2)
        state, echo, prior, told = both
        echo *= kept
        echo[:, size:] -= 2.0 * state[:, size:]
        state[:, size:] *= -1.0
        prior[:, :size] += stay
        prior[:, size:] += change
        pulse = strength[:, None] * echo
        told += pulse * (value - 0.5 * pulse)
        best = np.arange(2 * size)[None]
        if 2 * size > _BEAM:
            best = np.argpartition(told + prior, 2 * size - _BEAM, axis=1)[:, 2 * size - _BEAM :]
        chosen[row, :, : best.shape[1]] = best
        course = both[:, each, best]
    state, _, prior, told = course
    total = np.logaddexp.reduce(told + prior, axis=1)
    chain, index = np.arange(chains), np.argmax(told + prior, axis=1)
    likelihood, now = told[chain, index], state[chain, index]
    states = np.empty((len(summed), chains))
    for row in range(len(summed) - 1, -1, -1):
        states[row] = now
        came = chosen[row, chain, index]
        now = np.where(came >= sizes[row], -now, now)
        index = came % sizes[row]
    return [
        Course(states[:, one], float(total[one] - likelihood[one]), float(likelihood[one]))
        for one in range(chains)
    ]
