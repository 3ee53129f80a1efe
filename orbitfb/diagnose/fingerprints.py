"""The slice of the record that shows a cause best: what its absence leaves, against a driver.

With e the errors of the one-step prediction of the model without the cause and δ what the cause
makes of them, both are averaged in bins of a quantity that may drive the cause. Which quantity is
chosen by δ alone, never by the data: the one whose bins keep most of the power of δ. Where none
keeps a fair share of it, δ itself is the abscissa, and a right cause lies on the diagonal.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import Fingerprint
from orbitfb.diagnose.answer_values import numbers
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, columns_of
from orbitfb.diagnose.replay import Model, Replay
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix

_BINS = 12
_FAIR = 0.3
"""Share of the power of δ that the bins of a driver must keep."""
_MOST_DEVICES = 12
"""Correctors beyond which they are not looked at one by one: their orbits overlap."""
_TURN = 2.0 * np.pi
_SLOW = ("bpm-current", "insertion-device")
"""Effects that follow a slow channel of the record."""


@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    """Errors and what the cause makes of them, row by row and device by device.

    Args:
        label: What they are, with the unit.
        left: e, shape (N, k).
        expected: δ, shape (N, k).
        drivers: What may drive the cause: label, and values of shape (N, k) or (N, 1).
    """

    label: str
    left: Matrix
    expected: Matrix
    drivers: tuple[tuple[str, Matrix], ...]


def fingerprints(bench: Bench) -> tuple[Fingerprint, ...]:
    """Show every cause with a course in time.

    Args:
        bench: The record under the causes that were found.
    """
    replay = Replay.of(bench)
    after = replay.errors(Model(bench.causes))
    found = (_fingerprint(bench, replay, after, index) for index in range(len(bench.causes)))
    return tuple(one for one in found if one is not None)


def _fingerprint(bench: Bench, replay: Replay, after: Matrix, index: int) -> Fingerprint | None:
    cause = bench.causes[index]
    others = (*bench.causes[:index], *bench.causes[index + 1 :])
    before = replay.errors(Model(others))
    its = _slice(bench, replay, cause, before, before - after)
    rows = replay.counted() & (np.arange(len(before)) >= cause.onset)
    its = replace(
        its,
        left=its.left[rows],
        expected=its.expected[rows],
        drivers=tuple((label, values[rows]) for label, values in its.drivers),
    )
    power = float(np.sum(its.expected**2))
    if not power > 0.0:
        return None
    label, members, share = _best(its, power)
    return _drawn(cause, its, label, members, share)


def _slice(bench: Bench, replay: Replay, cause: Cause, before: Matrix, delta: Matrix) -> _Slice:
    kind, record = cause.kind, bench.record
    common = tuple(_common(bench, cause))
    if isinstance(kind, SensorKind):
        columns = columns_of(cause, before.shape[1])
        orbit = 1e6 * replay.orbit[:, columns]
        drivers = (
            ("change of the orbit there [µm]", _step(orbit)),
            ("change of the orbit there a tick ago [µm]", _earlier(_step(orbit))),
            ("orbit there [µm]", orbit),
        )
        own = 1e6 * before[:, columns], 1e6 * delta[:, columns]
        return _Slice("reading − prediction [µm]", *own, (*drivers, *common))
    acts = isinstance(kind, ActuatorKind)
    places = columns_of(cause, record.setpoints.shape[1]) if acts else []
    if 0 < len(places) <= _MOST_DEVICES:
        shapes = replay.floor.to_modes(record.layout.response[:, places].T) / replay.deviation
        left = 1e3 * _along(replay, before, shapes)
        expected = 1e3 * _along(replay, delta, shapes)
        setpoints = 1e3 * record.setpoints[:, places]
        return _Slice(
            "current beyond the setpoint [mA]",
            left,
            expected,
            (
                ("change of the setpoint [mA]", _step(setpoints)),
                ("change of the setpoint a tick ago [mA]", _earlier(_step(setpoints))),
                ("setpoint [mA]", setpoints),
                *common,
            ),
        )
    white = replay.floor.to_modes(delta) / replay.deviation
    pattern = np.linalg.eigh(white.T @ white)[1][:, -1:].T
    shape = replay.floor.to_bpms(pattern * replay.deviation)
    scale = 1e6 * float(np.sqrt(np.mean(shape**2)))
    moved = record.setpoints @ record.layout.response.T
    made = scale * _along(replay, moved, pattern)
    drivers = (
        ("what the correctors change along it [µm]", _step(made)),
        ("what they changed a tick ago [µm]", _earlier(_step(made))),
        ("what the correctors make along it [µm]", made),
    )
    return _Slice(
        "orbit − prediction along its pattern [µm]",
        scale * _along(replay, before, pattern),
        scale * _along(replay, delta, pattern),
        (*drivers, *common),
    )


def _common(bench: Bench, cause: Cause) -> Iterator[tuple[str, Matrix]]:
    """Drivers that any cause may have: time, phase, slow channels."""
    record = bench.record
    if isinstance(cause.kind, SourceKind) and cause.kind.periodic:
        turns = (record.time * cause.values["frequency"]) % 1.0
        yield f"phase of {cause.values['frequency']:.4g} Hz [rad]", _TURN * turns[:, None]
    yield "time since the first reading [s]", record.time[:, None]
    if cause.kind.id in _SLOW:  # any other would follow them by chance, if it happens once
        for name, values in record.auxiliary.items():
            if np.isfinite(values).all() and np.ptp(values) > 0.0:
                yield name, values[:, None]


def _along(replay: Replay, orbits: Matrix, shapes: Matrix) -> Matrix:
    """Amplitudes of patterns in orbits, each by itself, in the metric of the noise, (N, k).

    Args:
        replay: Whose noise counts.
        orbits: Shape (N, n) [m].
        shapes: Patterns in the modes, in units of the noise, shape (k, n).
    """
    white = replay.floor.to_modes(orbits) / replay.deviation
    return white @ shapes.T / np.maximum(np.sum(shapes**2, axis=1), 1e-300)


def _step(rows: Matrix) -> Matrix:
    return np.diff(rows, axis=0, prepend=rows[:1])


def _earlier(rows: Matrix) -> Matrix:
    return np.vstack([np.zeros_like(rows[:1]), rows[:-1]])


def _best(its: _Slice, power: float) -> tuple[str, Vector, float]:
    """Driver whose bins keep most of δ; δ itself where none keeps enough."""
    best: tuple[str, Vector, float] = ("", np.zeros(0), 0.0)
    for label, values in its.drivers:
        course = np.broadcast_to(values, its.expected.shape).ravel()
        bins = _binned(course, its.expected.ravel())
        count = np.maximum(np.bincount(bins, minlength=_BINS), 1)
        sums = np.bincount(bins, its.expected.ravel(), minlength=_BINS)
        share = float(np.sum(sums**2 / count)) / power
        if share > best[2]:
            best = (label, course, share)
    if best[2] >= _FAIR:
        return best
    unit = its.label[its.label.rindex("[") :]
    return f"what the cause makes of it {unit}", its.expected.ravel(), 1.0


def _binned(course: Vector, expected: Vector) -> np.ndarray:
    """Bin of every value: half of what is shared out is the power of δ, half the number."""
    order = np.argsort(course, kind="stable")
    power = expected[order] ** 2
    weight = np.cumsum(power / max(float(power.sum()), 1e-300) + 1.0 / len(power)) / 2.0
    # what is alike belongs together
    edges = course[order][np.searchsorted(weight, np.arange(1, _BINS) / _BINS)]
    return np.searchsorted(np.unique(edges), course, side="right")


def _drawn(cause: Cause, its: _Slice, label: str, course: Vector, share: float) -> Fingerprint:
    expected, left = its.expected.ravel(), its.left.ravel()
    bins = _binned(course, expected)
    count = np.bincount(bins, minlength=_BINS)
    full = count > 0

    def mean(values: Vector) -> Vector:
        return np.bincount(bins, values, minlength=_BINS)[full] / count[full]

    noise = float(np.std(left - expected))
    name = cause.kind.id
    said = f" This slice shows {share:.0%} of it." if share < 1.0 else ""
    return Fingerprint(
        title=f"What the model without {name} leaves, and what {name} makes of it.{said}",
        x_label=label,
        y_label=its.label,
        x=numbers(mean(course)),
        measured=numbers(mean(left)),
        nominal=numbers(np.zeros(int(full.sum()))),
        refit=numbers(mean(expected)),
        error=numbers(noise / np.sqrt(count[full])),
    )
