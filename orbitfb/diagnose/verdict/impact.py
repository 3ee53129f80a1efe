"""How large the gap is, and how far it shrinks with the causes in the model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_parts import Gap, Shrink
from orbitfb.diagnose.hypotheses.row_sums import moving_root
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.naming import column_names
from orbitfb.diagnose.verdict.named import Named
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform


@dataclass(frozen=True, slots=True, eq=False)
class OneStep:
    """Mean squares of the error of a prediction one row ahead, by BPM, shape (n,) [m²].

    Args:
        floor: What noise and walk alone leave.
        nominal: What the nominal model leaves, healthy errors in it.
        mended: The same with the causes in the model.
        rows: Rows over which the mean goes.
    """

    floor: Vector
    nominal: Vector
    mended: Vector
    rows: int

    @classmethod
    def of(cls, space: Workspace) -> "OneStep":
        """Predict every row from those before it, with the final floor."""
        noise, transform = space.noise, space.transform
        every = space.errors.mean()
        mean = np.where(space.single > 0.0, 0.0, every)
        for block, share in zip(space.blocks, space.shares, strict=True):
            if block.accepted or share > 1.0:
                mean[block.columns] = 0.0
        healthy = space.terms.contribution(mean)
        accepted = space.terms.contribution(every) - healthy
        nominal = innovations(space.plain - healthy, noise, transform)
        mended = innovations(space.residual - healthy - accepted, noise, transform)
        back = noise.white @ noise.modes
        floor = (back**2) @ (1.0 / moving_root(noise.ratio))
        return cls(floor, np.mean(nominal**2, axis=0), np.mean(mended**2, axis=0), len(transform))


def innovations(spectrum: Matrix, noise: StepNoise, transform: StepTransform) -> Matrix:
    """Errors of the prediction one row ahead, shape (T, n) [m].

    Every mode is a first-order moving average, whose innovations follow its steps.

    Args:
        spectrum: Transformed steps, shape (T, n) [m].
        noise: Covariances of walk and noise.
        transform: Of the record.
    """
    steps = transform.turn(spectrum) @ noise.modes
    roots = moving_root(noise.ratio)
    found = np.empty_like(steps)
    for mode, root in enumerate(roots):
        found[:, mode] = np.asarray(lfilter([1.0], [1.0, -float(root)], steps[:, mode]))
    return found @ (noise.white @ noise.modes).T


def gap(space: Workspace, step: OneStep, causes: Sequence[Named], rest: float) -> Gap:
    """Tell the gap.

    Args:
        space: Of the record, all causes explained.
        step: One-step errors.
        causes: That were named.
        rest: What a free course explains beside them [nats].
    """
    stages: dict[str, float | None] = {}
    for one in causes:
        stages[one.kind.stage] = (stages.get(one.kind.stage) or 0.0) + one.evidence / step.rows
    whole = (sum(one.evidence for one in causes) + rest) / step.rows
    spread = 1.645 * np.sqrt(2.0 * max(whole, 0.0) / step.rows)
    above = np.maximum(step.nominal - step.mended, 0.0)
    names = column_names(space.signals.record.layout.bpms)
    return Gap(
        nats_per_tick=whole,
        low=max(whole - spread, 0.0),
        high=whole + spread,
        um=1e6 * float(np.sqrt(np.mean(above))) if causes else 0.0,
        floor_um=1e6 * float(np.sqrt(np.mean(step.floor))),
        resolved=bool(causes) or rest > 0.0,
        by_stage=stages,
        um_by_bpm={name: 1e6 * float(np.sqrt(v)) for name, v in zip(names, above, strict=True)},
        floor_from="what a saturated linear model leaves of the record",
    )


def shrink(step: OneStep, on: str, counts: bool) -> Shrink | None:
    """Tell how much of the gap is gone; None where the causes say nothing of the orbit.

    Args:
        step: One-step errors.
        on: Which data, in words.
        counts: Whether the causes change the predicted orbit.
    """
    if not counts:
        return None
    before = float(np.mean(step.nominal - step.floor))
    after = float(np.mean(step.mended - step.floor))
    gone = float(np.mean(step.nominal - step.mended))
    whole = max(before, gone, 1e-300)
    left = max(after, 0.0)
    share = 1.0 - float(np.sqrt(min(left / whole, 1.0)))
    return Shrink(
        nats=max(min(gone / whole, 1.0), -1.0), low=None, high=None, um=share,
        held_out_ticks=step.rows, on=on,
        before_um=1e6 * float(np.sqrt(whole)), after_um=1e6 * float(np.sqrt(left)),
    )  # fmt: skip
