"""What the loop makes of the causes: the orbit as it is, and as it would be without them.

The law of the loop is read off the record, change = −K (orbit − reference) + dither. Then the loop
runs once more on the record's own noise and drift: with what the causes added to the readings,
which must give the measured orbit, and without it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.impact.pieces import columns_of
from orbitfb.diagnose.impact.windows import Windows, interval
from orbitfb.diagnose.result.blocks import ClosedLoop
from orbitfb.diagnose.result.values import numbers
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.priors import FOLLOWS
from orbitfb.estimation.transform import Matrix
from orbitfb.records.record import Record

_RIDGE = 1e-8
"""Ridge of the law's fit, of the mean square of the orbit: it keeps directions without motion
from having a gain."""

_LOST = 1e-2
"""Orbit at which a loop counts as lost [m]: outside of any vacuum chamber."""

_LINEAR = 1e-6
"""Share of a course's square that a gain may leave of it [1]: rounding, no law of another form."""

_SEGMENT, _LEAST_SEGMENT = 256, 32
"""Rows of a segment of the spectra, and of the shortest record that has spectra."""


def closed_loop(its: Explained, causes: Sequence[Named], windows: Windows) -> ClosedLoop:
    """Tell the rms of the orbit about its reference, as measured, with and without the causes.

    Args:
        its: What the causes add to the readings.
        causes: In their order.
        windows: Of the record.
    """
    record = its.space.signals.record
    off = record.readings - _reference(record)
    measured = 1e6 * float(np.sqrt(np.mean(off**2)))
    steps = its.space.transform.step_rows()
    sums = windows.sums(np.mean(off[steps] ** 2, axis=1))
    low, high = interval(1e6 * np.sqrt(windows.drawn(sums) / windows.drawn(windows.lengths)))
    frequency, spectrum = _spectrum(record, off)
    law, follows = law_of(record)
    if law is None:
        why = "too few ticks to estimate the law of the loop"
        if np.isfinite(follows):
            why = f"a linear law explains only {follows:.0%} of the requested changes"
        return ClosedLoop(
            without_um=None, measured_um=measured, measured_low=low, measured_high=high,
            frequency_hz=numbers(frequency), psd_measured=numbers(spectrum),
            note=f"not predicted: {why}",
        )  # fmt: skip
    added = its.space.transform.summed(its.named)
    # What the loop is run on: what nothing moves, less what the causes added to it.
    moved = record.readings - record.setpoints @ record.layout.response.T
    runs = replayed(record, law, (moved, moved - added) if its.counts else (moved,))
    with_um, without_um = (None if run is None else _rms(run) for run in (runs[0], runs[-1]))
    mended = _mended_response(its, causes)
    note = "" if its.counts else "the cause is noise, which cannot be removed from the record"
    if its.counts and runs[-1] is None:
        note = "not predicted: the simulated loop without the causes runs away"
    return ClosedLoop(
        without_um=without_um if its.counts else None,
        with_um=with_um,
        measured_um=measured, measured_low=low, measured_high=high,
        radius_without=_radius(record.layout.response, law),
        radius_with=None if mended is None else _radius(mended, law),
        frequency_hz=numbers(frequency), psd_measured=numbers(spectrum),
        psd_without=numbers(_spectrum(record, runs[-1])[1])
        if its.counts and runs[-1] is not None else (),
        note=note,
    )  # fmt: skip


def law_of(record: Record) -> tuple[Matrix | None, float]:
    """Estimate K of change = −K (orbit − reference) + dither.

    Returns:
        K, shape (m, n) [A/m], None where the changes do not follow such a law; and the share of
        their variance that it explains on rows it was not fitted to, NaN where there are too few.
    """
    known: Mask = np.all(np.isfinite(record.requested), axis=1)
    change = record.requested - (0.0 if record.dither is None else record.dither)
    error = record.readings - _reference(record)
    fitted = known & ((np.arange(len(record)) // 10) % 2 == 0)
    judged = known & ~fitted
    if fitted.sum() <= error.shape[1]:
        return None, np.nan
    trial = _ridge(error[fitted], change[fitted])
    size = float(np.sum(change[judged] ** 2))
    missed = float(np.sum((change[judged] + error[judged] @ trial.T) ** 2))
    follows = max(1.0 - missed / size, 0.0) if size > 0.0 else 0.0
    return (_ridge(error[known], change[known]) if follows >= FOLLOWS else None), follows


def _ridge(error: Matrix, change: Matrix) -> Matrix:
    normal = error.T @ error
    normal[np.diag_indices_from(normal)] += _RIDGE * np.trace(normal) / len(normal)
    return np.asarray(-np.linalg.solve(normal, error.T @ change).T, dtype=np.float64)


def replayed(record: Record, law: Matrix, moved: Sequence[Matrix]) -> list[Matrix | None]:
    """Run the loop anew: orbits about the reference, (N, n) [m] each; None of one that is lost.

    Every stretch begins with the setpoints that were in force.

    Args:
        record: Whose references and dither the runs have.
        law: K, shape (m, n) [A/m].
        moved: What the correctors do not make of the readings, by run, shape (N, n) [m].
    """
    reference, response = _reference(record), record.layout.response
    dither = np.zeros_like(record.setpoints) if record.dither is None else record.dither
    dither = np.where(np.isfinite(dither), dither, 0.0)
    told = np.stack([one - reference for one in moved], axis=1)
    off = np.empty_like(told)
    setpoints = np.zeros((len(moved), record.setpoints.shape[1]))
    # Of a row of one stretch: (runs, n) of readings, (runs, m) of setpoints.
    for row in range(len(record)):
        if record.starts[row]:
            setpoints = np.repeat(record.setpoints[row][None], len(moved), axis=0)
        off[row] = told[row] + setpoints @ response.T
        setpoints = setpoints - np.clip(off[row], -_LOST, _LOST) @ law.T + dither[row]
    return [
        off[:, run] if np.max(np.abs(off[:, run])) < _LOST else None for run in range(len(moved))
    ]


@dataclass(frozen=True, slots=True)
class _Gain:
    place: int
    gain: float


def _mended_response(its: Explained, causes: Sequence[Named]) -> Matrix | None:
    """The response with the causes, where they are gains of correctors; None where they are not."""
    space = its.space
    response = space.signals.record.layout.response.copy()
    for cause in causes:
        if cause.kind.target != "corrector":
            return None
        for part in cause.parts:
            found: list[_Gain] = []
            columns = columns_of(part, space)
            if len(columns):
                block = next(
                    b for b in space.blocks if b.columns.start <= columns[0] < b.columns.stop
                )
                if not block.law.driven:
                    return None
                found = [_Gain(int(c) - block.columns.start, float(its.sizes[c])) for c in columns]
            for one in part.sources:
                gains = _gains(one.law, one.places, one.of(space.signals, one.values), its)
                if gains is None or one.onset:
                    return None
                sizes = np.broadcast_to(one.size, len(gains))
                found += [_Gain(g.place, g.gain * s) for g, s in zip(gains, sizes, strict=True)]
            if not found:
                return None
            for each in found:
                response[:, each.place] *= 1.0 + each.gain
    return response


def _gains(
    law: DeviceLaw, places: Sequence[int], courses: tuple[Matrix, ...], its: Explained
) -> list[_Gain] | None:
    """Courses as multiples of their correctors' setpoints; None where one is of another form."""
    currents = its.space.signals.currents
    chosen = list(places) if places else list(range(currents.shape[1]))
    course = courses[0]
    if not law.driven or course.shape[1] != len(chosen):
        return None
    moving = currents[:, chosen] - currents[:, chosen].mean(axis=0)
    driven = course - course.mean(axis=0)
    gain = np.sum(moving * driven, axis=0) / np.maximum(np.sum(moving**2, axis=0), 1e-300)
    rest = np.sum((driven - gain * moving) ** 2, axis=0)
    if np.any(rest > _LINEAR * np.sum(driven**2, axis=0) + 1e-300):
        return None
    return [_Gain(place, float(one)) for place, one in zip(chosen, gain, strict=True)]


def _radius(response: Matrix, law: Matrix) -> float:
    """Spectral radius of the loop u ← u − K R u on the correctors."""
    return float(np.max(np.abs(np.linalg.eigvals(np.eye(law.shape[0]) - law @ response))))


def _reference(record: Record) -> Matrix:
    return np.zeros_like(record.readings) if record.reference is None else record.reference


def _rms(off: Matrix) -> float:
    return 1e6 * float(np.sqrt(np.mean(off**2)))


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
