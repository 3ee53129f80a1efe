"""The record that a planned excitation would give, but for noise.

It is made from the last rows of the one at hand: its setpoints, with the excursion and what the
feedback makes of it. The feedback's gain is read off the record, mode by mode of the response.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.terms import Terms
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.estimation.evidence import NormalPriors
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Indices, Matrix, StepTransform
from orbitfb.records.record import Record

ROWS = 400
"""Rows that are simulated for an excitation."""

Struck = Mapping[str, tuple[int, ...]]
"""Devices of every target of effects that may have healthy errors; empty: all of that target."""


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """A record that an excitation would give, but for noise.

    Args:
        signals: With predicted readings.
        transform: Of its steps.
        noise: The floor of the record at hand.
        terms: Columns of the healthy errors that count.
        variance: Of their sizes, up to what a healthy ring may have, shape (k,).
        information: Of the columns, shape (k, k).
    """

    signals: Signals
    transform: StepTransform
    noise: StepNoise
    terms: Terms
    variance: Vector
    information: Matrix

    def told(self, fields: list[Matrix]) -> Matrix:
        """Information of whole fields, shape (T, n) each [m], healthy errors marginalised."""
        weighed = [self.noise.pull_by_band(one, self.transform) for one in fields]
        whole = np.array([[float(np.sum(a * b)) for b in fields] for a in weighed])
        if not len(self.terms):
            return whole
        cross = np.stack([self.terms.pull(one) for one in weighed], axis=1)
        return NormalPriors.of(self.information, self.variance).beyond(whole, cross)


def outlook(
    space: Workspace, excursion: Matrix, gains: Vector, struck: Struck | None = None
) -> Outlook:
    """Simulate the record that an excitation would give.

    Args:
        space: The record at hand.
        excursion: Around the setpoints of the feedback, shape (T, m) [A]; T at most as many as
            `base_rows` gives.
        gains: Of the feedback by mode, from `loop_gains`.
        struck: Devices whose healthy errors count; None: all, which takes many times as long.
    """
    record, response = space.signals.record, space.signals.record.layout.response
    longest = max(record.stretches, key=lambda part: part.stop - part.start)
    begin = longest.stop - len(excursion)
    moved = answered(excursion, response, gains)
    base = record.rows(begin, longest.stop)
    orbit = space.signals.orbit[begin : longest.stop] + moved @ response.T
    ahead = replace(base, readings=orbit, setpoints=base.setpoints + moved)
    signals = Signals(ahead, ahead.setpoints, orbit)
    transform = StepTransform.of(ahead.starts, 16)
    terms, variance = _errors(space, signals, transform, struck)
    information = terms.information(space.noise, transform)
    return Outlook(signals, transform, space.noise, terms, variance, information)


def _errors(
    space: Workspace, signals: Signals, transform: StepTransform, struck: Struck | None
) -> tuple[Terms, Vector]:
    """Columns of healthy errors of devices, and the variances that a healthy ring may have."""
    layout = signals.record.layout
    patterns: list[Matrix] = [np.zeros((len(layout.bpms), 0))]
    courses: list[Matrix] = [np.zeros((transform.rows, 0))]
    variance: list[Vector] = [np.zeros(0)]
    kinds = {block.kind.id: block.kind for block in space.blocks if not block.accepted}
    for kind in kinds.values():
        limit = kind.healthy_scatter(layout)
        if limit is None or kind.linear is None:
            continue
        if struck is not None and kind.target not in struck:
            continue
        law = next(one for one in kind.laws(signals) if isinstance(one, DeviceLaw))
        of_ring = kind.target == "ring"  # one error, wherever the ring is struck
        places = None if struck is None or of_ring else struck[kind.target]
        chosen: Indices = np.array(places or range(len(limit)), dtype=np.intp)
        values = {parameter.name: parameter.typical for parameter in kind.parameters}
        for block, course in zip(law.patterns, law.course(values, signals), strict=True):
            if np.any(block):
                patterns.append(block[:, chosen])
                courses.append(course[:, chosen] / values[kind.linear])
                variance.append(limit[chosen] ** 2)
    every = np.hstack(patterns)
    terms = Terms.of(every, np.arange(every.shape[1]), np.hstack(courses), transform)
    return terms, np.concatenate(variance)


def base_rows(record: Record) -> int:
    """Tell how many rows a simulated excitation may have."""
    return min(ROWS, max(part.stop - part.start for part in record.stretches))


def loop_gains(record: Record) -> Vector:
    """Read the feedback's gain off a record: share of each mode's orbit taken back in a tick.

    Returns:
        Shape (min(n, m),), from 0 to 1.
    """
    left, size, right = np.linalg.svd(record.layout.response, full_matrices=False)
    known = np.isfinite(record.requested).all(axis=1)
    error = record.readings if record.reference is None else record.readings - record.reference
    asked = record.requested if record.dither is None else record.requested - record.dither
    orbit, change = error[known] @ left, asked[known] @ right.T
    power = np.sum(orbit**2, axis=0)
    slope = -np.sum(orbit * change, axis=0) / np.maximum(power, 1e-300)
    return np.clip(slope * size, 0.0, 1.0)


def answered(excursion: Matrix, response: Matrix, gains: Vector) -> Matrix:
    """Add what the feedback does against an excursion to it, shape (T, m) [A]."""
    modes = np.linalg.svd(response, full_matrices=False)[2]
    wanted = excursion @ modes.T
    change = np.zeros_like(wanted)
    for mode, gain in enumerate(gains):
        # u_k = d_k + c_k and c_{k+1} = c_k − g u_k: c_{k+1} = (1 − g) c_k − g d_k
        change[:, mode] = lfilter([0.0, -gain], [1.0, gain - 1.0], wanted[:, mode])
    return excursion + change @ modes
