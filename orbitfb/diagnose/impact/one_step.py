"""Errors of predictions without and with the causes, against a floor that causes cannot raise."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.innovations import (
    at_bpms,
    errors_ahead,
    floor_of,
    independent,
    whitened,
)
from orbitfb.diagnose.impact.windows import Windows, interval, quiet_level
from orbitfb.diagnose.result.blocks import KStep
from orbitfb.diagnose.result.parts import Shrink
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix

AHEAD = (1, 2, 5, 10, 20)
"""Rows ahead that predictions are told for: the loop answers within the first ones, a plan for an
experiment looks a second or two ahead."""


@dataclass(frozen=True, slots=True, eq=False)
class OneStep:
    """Errors of a prediction one row ahead.

    Args:
        white: Innovations of the nominal model, healthy errors in it, and of the one with the
            causes, shape (T, n) each.
        nominal: Of the nominal model, shape (T, n) [m].
        mended: With the causes, shape (T, n) [m].
        floor: Mean square that noise and walk alone leave, shape (n,) [m²].
        windows: Of the record.
    """

    white: tuple[Matrix, Matrix]
    nominal: Matrix
    mended: Matrix
    floor: Vector
    windows: Windows

    @classmethod
    def of(cls, its: Explained, windows: Windows, healthy: StepNoise | None = None) -> "OneStep":
        """Predict every row from those before it.

        The floor is estimated on what a saturated model leaves, which has taken its degrees of
        freedom from the noise, as the healthy errors have theirs from what the causes leave.

        Args:
            its: What the causes add, and the floor.
            windows: Of the record.
            healthy: Floor of another time, of about as many rows; the lower one counts.
        """
        transform = its.space.transform
        nominal, mended = (whitened(one, its.noise, transform) for one in (its.nominal, its.left))
        before, after = (at_bpms(one, its.noise) for one in (nominal, mended))
        wide, own = its.fitted_shares()
        floor = floor_of(its.noise) * (1.0 - own) / (1.0 - wide)
        readings = independent(its.noise)
        floor *= quiet_level(after, readings, windows)
        if healthy is not None:
            # Both scatter, so that the lower one counts where it is so by more than both.
            scatter = 2.0 * float(np.sqrt(1.0 / (len(after) * readings)))
            there = floor_of(healthy) / (1.0 - wide)
            if np.mean(there) < np.mean(floor) * (1.0 - 3.0 * scatter):
                floor = there
        return cls((nominal, mended), before, after, floor, windows)

    @property
    def above(self) -> tuple[Vector, Vector]:
        """Mean square that the causes take off, by BPM (n,), and of draws (DRAWS,) [m²]."""
        gone = self.nominal**2 - self.mended**2
        sums = self.windows.sums(gone.mean(axis=1))
        lengths = self.windows.drawn(self.windows.lengths)
        return gone.mean(axis=0), self.windows.drawn(sums) / lengths


def shrink(step: OneStep, on: str, named: float, rest: float) -> Shrink:
    """Tell how much of the gap is gone with what is named.

    What is left of the orbit's error is never less than the floor of quiet windows makes it, nor
    than what a free course still finds: that has a share of the energy as of the evidence. The
    values were fitted to a few numbers of hundred thousands, so that the data of the fit tell the
    same as data that were not used, to a thousandth. Where the causes take nothing off the orbit's
    error, and the floor is all there is, no gap is resolved.

    Args:
        step: Errors of the prediction one row ahead.
        on: Which data, in words.
        named: What the causes explain there [nats].
        rest: What a free course explains beside them [nats].
    """
    windows = step.windows
    sums = windows.sums(
        np.stack([np.mean(step.nominal**2, axis=1), np.mean(step.mended**2, axis=1)], axis=1)
    )
    usual, floor = sums.sum(axis=0) / windows.lengths.sum(), float(np.mean(step.floor))
    gone = max(float(usual[0] - usual[1]), 0.0)
    open_share = rest / (named + rest) if rest > 0.0 and named > 0.0 else 0.0
    beside = gone * open_share / max(1.0 - open_share, 1e-3)

    def share(before: Vector, after: Vector) -> tuple[Vector, Vector, Vector]:
        left = np.maximum(after - floor, beside)
        whole = np.maximum(before - after, 0.0) + left
        kept = np.divide(left, whole, out=np.ones_like(whole), where=whole > 0.0)
        return 1.0 - np.sqrt(kept), whole, left

    drawn = windows.drawn(sums) / windows.drawn(windows.lengths)[:, None]
    um, whole, left = share(usual[:1], usual[1:])
    low, high = interval(share(drawn[:, 0], drawn[:, 1])[0])
    nats, least, most = 1.0 - (1.0 - um[0]) ** 2, 1.0 - (1.0 - low) ** 2, 1.0 - (1.0 - high) ** 2
    return Shrink(
        nats=min(nats, 1.0 - open_share), low=min(least, 1.0 - open_share), high=most,
        um=float(um[0]), um_low=min(low, float(um[0])), um_high=max(high, float(um[0])),
        held_out_ticks=len(step.nominal), on=on, resolved=bool(whole[0] > 0.0),
        before_um=1e6 * float(np.sqrt(whole[0])), after_um=1e6 * float(np.sqrt(left[0])),
    )  # fmt: skip


def k_steps(its: Explained, step: OneStep) -> tuple[KStep, ...]:
    """Tell the errors of predictions several rows ahead, all of one scale [µm rms]."""
    return tuple(_k_steps(its, step))


def _k_steps(its: Explained, step: OneStep) -> Iterator[KStep]:
    transform, noise = its.space.transform, its.noise
    longest = max(part.stop - part.start for part in transform.pieces)
    ratio = float(np.mean(step.floor) / np.mean(floor_of(noise)))
    for ahead in AHEAD:
        if ahead > longest // 10:
            return
        errors = (errors_ahead(white, noise, transform, ahead) for white in step.white)
        nominal, mended = (1e6 * float(np.sqrt(np.mean(one**2))) for one in errors)
        floor = 1e6 * float(np.sqrt(ratio * np.mean(floor_of(noise, ahead))))
        # Ground that comes back leaves less than a walk does: no error is below the noise in it.
        floor = min(floor, nominal, mended)
        yield KStep(k=ahead, nominal_um=nominal, effect_um=mended, floor_um=floor)
