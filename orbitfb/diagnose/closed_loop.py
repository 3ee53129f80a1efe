"""What the loop makes of the gap: orbit rms predicted without and with the causes, and measured.

The law of the loop is not in the record; it is estimated as a linear one, change = −K (orbit −
reference) + the logged dither, when the requested changes follow such a law closely enough.
Then the loop is simulated with the floor's own noise, drawn anew, and the logged references and
dither: on the nominal model, and with the causes as they act in the simulated ring.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch
from scipy.stats import t as student

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import ClosedLoop
from orbitfb.diagnose.answer_values import numbers
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import Draws, interval
from orbitfb.diagnose.explain import Cause, columns_of
from orbitfb.diagnose.loop_law import linear_law, reference_of
from orbitfb.diagnose.loop_run import Runs, effects_of, run_loop
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_RUNS = 4
_NINETY = 0.95
_SEGMENT = 256
"""Ticks of a segment of the spectra."""
_LEAST_SEGMENT = 32
_MADE_UP = ("bpm-current", "insertion-device")
"""Effects that follow a channel of the record, for which the simulated ring has its own course."""


@dataclass(frozen=True, slots=True, eq=False)
class _Prediction:
    """Rms of every run [µm], and the spectrum of the orbit [µm²/Hz]."""

    rms: Vector
    spectrum: Vector

    @property
    def value(self) -> float:
        return float(np.sqrt(np.mean(self.rms**2)))

    @property
    def ends(self) -> tuple[float, float]:
        """Where 90 % of records of this length would lie, as the runs scatter."""
        runs = len(self.rms)
        reach = float(student.ppf(_NINETY, runs - 1) * np.std(self.rms, ddof=1))
        reach *= float(np.sqrt(1.0 + 1.0 / runs))
        return max(self.value - reach, 0.0), self.value + reach


def closed_loop(
    bench: Bench,
    later: Record | None = None,
    seed: int = 0,
    causes: Sequence[Cause] | None = None,
) -> ClosedLoop:
    """Predict the rms of the orbit about its reference without and with the causes.

    Args:
        bench: The record under the causes that were found.
        later: The record to be predicted, which has the causes from its beginning on; the
            bench's own when None.
        seed: Of the noise that is drawn.
        causes: All that were found, those without a course in time too; the bench's when None.

    Returns:
        The measured rms always; a prediction is null, and the note says why, when the law cannot
        be estimated, a simulated loop is lost, or a cause cannot be simulated.
    """
    record = bench.record if later is None else later
    off = record.readings - reference_of(record)
    draws = Draws.of(np.ones(len(record), dtype=np.bool_), seed)
    measured = interval(np.sqrt(draws.means(1e12 * np.mean(off**2, axis=1))))
    frequency, spectrum = _spectrum(record, off)
    law, follows = linear_law(record, bench.record)
    if law is None:
        return ClosedLoop(
            without_um=None,
            measured_um=measured.value,
            measured_low=measured.low,
            measured_high=measured.high,
            frequency_hz=numbers(frequency),
            psd_measured=numbers(spectrum),
            note=f"not predicted: {_why_no_law(follows)}",
        )
    acting = tuple(bench.causes if causes is None else causes)
    nominal = _predict(bench, record, law, (), seed)
    reason = _unable(acting)
    mended = None
    if not reason:
        onsets = later is None
        mended = _predict(bench, record, law, acting, seed, onsets=onsets)
        reason = "" if mended is not None else "the simulated loop with the causes is lost"
    static = mended_response(bench.record, acting)
    low, high = (None, None) if mended is None else mended.ends
    return ClosedLoop(
        without_um=None if nominal is None else nominal.value,
        with_um=None if mended is None else mended.value,
        with_low=low,
        with_high=high,
        measured_um=measured.value,
        measured_low=measured.low,
        measured_high=measured.high,
        radius_without=_radius(record.layout.response, law),
        radius_with=None if static is None else _radius(static, law),
        frequency_hz=numbers(frequency),
        psd_measured=numbers(spectrum),
        psd_without=() if nominal is None else numbers(nominal.spectrum),
        psd_with=() if mended is None else numbers(mended.spectrum),
        note=_note(nominal, reason),
    )


def _why_no_law(follows: float) -> str:
    if np.isnan(follows):
        return "too few ticks to tell the law of the loop"
    return f"a linear law explains {follows:.0%} of the requested changes"


def _note(nominal: _Prediction | None, reason: str) -> str:
    parts = [] if nominal is not None else ["the simulated loop of the nominal model is lost"]
    if reason:
        parts.append(f"not predicted with the causes: {reason}")
    return "; ".join(parts)


def _unable(causes: Sequence[Cause]) -> str:
    """Say why the loop cannot be simulated with these causes; empty when it can."""
    for cause in causes:
        if cause.kind.id in _MADE_UP:
            return f"{cause.kind.id} follows a channel whose course the simulated ring makes up"
        if isinstance(cause.kind, NoiseKind):
            return f"what {cause.kind.id} adds is in the floor of the record, and cannot be parted"
    return ""


def mended_response(record: Record, causes: Sequence[Cause]) -> Matrix | None:
    """The response with the causes, where they are gains of correctors; None where they are not.

    The currents are regressed on the setpoints of the record; a gain leaves nothing.
    """
    response = record.layout.response.copy()
    probe = record.setpoints
    for cause in causes:
        kind = cause.kind
        if not isinstance(kind, ActuatorKind):
            return None
        for column in columns_of(cause, probe.shape[1]):
            course = probe[:, [column]]
            driven = kind.drive(course, cause.values, record)
            moving = course - course.mean()
            size = float(np.sum(moving**2))
            if not size > 0.0:
                return None
            gain = float(np.sum(moving * (driven - driven.mean()))) / size
            rest = driven - driven.mean() - gain * moving
            if np.sum(rest**2) > 1e-6 * size:
                return None
            response[:, column] *= gain
    return response


def _radius(response: Matrix, law: Matrix) -> float:
    """Spectral radius of the loop u ← u − K R u on the correctors."""
    return float(np.max(np.abs(np.linalg.eigvals(np.eye(law.shape[0]) - law @ response))))


def _predict(
    bench: Bench,
    record: Record,
    law: Matrix,
    causes: Sequence[Cause],
    seed: int,
    *,
    onsets: bool = True,
) -> _Prediction | None:
    """Simulate some runs; None when one of them is lost."""
    effects = [effects_of(causes, record.layout, seed + run, onsets=onsets) for run in range(_RUNS)]
    off = run_loop(Runs(record, bench.floor, law, effects, seed))
    if off is None:
        return None
    rms = 1e6 * np.sqrt(np.mean(off**2, axis=(1, 2)))
    return _Prediction(rms, np.mean([_spectrum(record, one)[1] for one in off], axis=0))


def _spectrum(record: Record, off: Matrix) -> tuple[Vector, Vector]:
    """Frequencies [Hz] and mean spectrum over the BPMs [µm²/Hz] of the longest stretch."""
    longest = max(record.stretches, key=lambda piece: piece.stop - piece.start)
    rows = 1e6 * off[longest]
    segment = min(_SEGMENT, len(rows))
    if segment < _LEAST_SEGMENT:
        return np.zeros(0), np.zeros(0)
    frequency, density = welch(rows, fs=1.0 / record.layout.period, nperseg=segment, axis=0)
    kept = slice(1, -1 if segment % 2 == 0 else None)  # neither the mean nor half a line
    return frequency[kept], density[kept].mean(axis=1)
