"""Courses that a law of a cause's devices may have, in words, and what each adds to the orbit."""

from collections.abc import Iterator

import numpy as np
from scipy.signal import lfilter

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, columns_of, explain
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix

_ALIKE = 0.9
"""Cosine of a source's orbit with that of a corrector that may be what makes it."""
_MEMORIES = (5.0, 20.0, 80.0, 300.0)
"""Time constants of slow followers [ticks]."""
_RANK = 2
_SMALL = 0.05
"""Part of an orbit's largest shape below which another one is not looked at."""
_TINY = 1e-300


def trials(bench: Bench, cause: Cause) -> Iterator[tuple[str, Matrix]]:
    """Courses in words, and what they add to the prediction, each of shape (N, n)."""
    wave = is_wave(cause)
    for patterns, course in _drives(bench, cause):
        courses = (*_in_proportion(course), *(() if wave else _bent(course)))
        for name, trial in (*courses, *_with_others(bench, course)):
            yield name, _from(cause.onset, trial) @ patterns.T
    yield from _heard(bench, cause)
    if wave or isinstance(cause.kind, SensorKind) or cause.kind.target == "bpm":
        return  # what a BPM makes of the orbit it makes of its noise too
    made = does(bench, cause)
    size = np.sqrt(np.mean(made**2, axis=1, keepdims=True))
    yield "more than in proportion to what it does", made * size / (np.mean(size) + _TINY)


def is_wave(cause: Cause) -> bool:
    """Whether a cause is a wave: nature's have harmonics, which no law lacks."""
    return isinstance(cause.kind, SourceKind) and cause.kind.periodic


def _from(onset: int, course: Matrix) -> Matrix:
    """A course that begins with a row; one that acts from the beginning is as it is."""
    if not onset:
        return course
    later = np.zeros_like(course)
    later[onset:] = course[onset:] - course[onset - 1]
    return later


def does(bench: Bench, cause: Cause) -> Matrix:
    """What a cause adds to the prediction, shape (N, n) [m]."""
    others = [one for one in bench.causes if one is not cause]
    without = explain(bench.record, others, bench.orbit).left
    return without - explain(bench.record, (*others, cause), bench.orbit).left


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
    modal = bench.floor.seen(np.column_stack([patterns[:, :1], response]))
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
        columns = own_columns(bench, cause, record.setpoints.shape[1])
        course = record.setpoints[:, columns]
        return layout.response[:, columns], course - course[:1]
    if isinstance(kind, SensorKind | PairKind):
        columns = own_columns(bench, cause, record.readings.shape[1])
        course = bench.orbit[:, columns]
        return np.eye(record.readings.shape[1])[:, columns], course - course.mean(axis=0)
    courses, heights, patterns = np.linalg.svd(does(bench, cause), full_matrices=False)
    rank = min(max(int(np.sum(heights > _SMALL * heights[0])), 1), _RANK)
    return patterns[:rank].T, courses[:, :rank] * heights[:rank]


def own_columns(bench: Bench, cause: Cause, count: int) -> list[int]:
    """Columns of a cause's devices among so many."""
    kind = cause.kind
    if isinstance(kind, PairKind):
        pairs = kind.pairs(bench.record.layout)[list(cause.places)]
        return [int(column) for column in np.unique(pairs)]
    return columns_of(cause, count)


def _in_proportion(course: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Courses in proportion to what drives a law, in words, each of its shape (N, P)."""
    rows = len(course)
    time = np.linspace(-1.0, 1.0, rows)[:, None]
    other = ((-1.0) ** np.arange(rows))[:, None]
    size = np.sqrt(np.mean(course**2, axis=0)) + _TINY
    step = np.diff(course, axis=0, prepend=course[:1])
    yield "in proportion", course
    yield "as the last change", step
    for late in (1, 2, 3):
        yield f"as the change {late + 1} ticks ago", _later(step, late)
    for memory in _MEMORIES:
        kept = float(np.exp(-1.0 / memory))
        slow = np.asarray(lfilter([1.0 - kept], [1.0, -kept], course, axis=0), dtype=np.float64)
        yield f"slowly, over {memory:.0f} ticks", slow
    yield "as the sum of all before", np.cumsum(course - course[:1], axis=0) / rows
    yield "in proportion, growing with time", course * time
    yield "in proportion, in the second half", course * (time > 0.0)
    yield "as the change, growing with time", step * time
    yield "in proportion, every other tick", course * other
    yield "as the change, every other tick", step * other
    yield "steadily with time", np.repeat(time, course.shape[1], axis=1) * size


def _bent(course: Matrix) -> Iterator[tuple[str, Matrix]]:
    """Courses that are not, as `_in_proportion`: of a wave they have its harmonics."""
    size = np.sqrt(np.mean(course**2, axis=0)) + _TINY
    step = np.diff(course, axis=0, prepend=course[:1])
    usual = np.sqrt(np.mean(step**2, axis=0)) + _TINY
    yield "as the square", course**2 / size
    yield "as the cube", course * (course / size) ** 2
    away = np.abs(course - course[:1])
    yield "more than in proportion to the way from where it began", course * away / size
    yield "as the change without its sign", np.abs(step)
    yield "more than in proportion to the change", step * np.abs(step) / usual
    yield "only when the direction turns", step * (step * _later(step, 1) < 0.0)
    yield "as all that went up", np.cumsum(np.maximum(step, 0.0), axis=0)
    together = np.mean(np.abs(course) / size, axis=1, keepdims=True)
    yield "the less, the more all are driven", course * together


def _later(course: Matrix, ticks: int) -> Matrix:
    return np.vstack([np.zeros((ticks, course.shape[1])), course[:-ticks]])
