"""The memory that the steps of the drift may have: a nuisance of two values.

What moves a magnet now often moves it on: the steps w of the walk then go with those before,
w_k = ρ w_{k−1} + new. The filter of a walk without memory follows its innovations e by its steady
gain L, which tells the last step as L² e (its share q / S of e), so a memory moves the next
prediction by ρ L² e: all of the last step in modes that walk far more than their noise, next to
nothing in the others. In between the step before is remembered too, and a walk that is fitted
without memory follows too fast: that is a part of L (1 − L) e. A loop steers by the same
innovations, so that both pass for gains or delays of all correctors: both are left free. But steps
only go on: what turns back from tick to tick is no drift.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.quick import Quick, Single
from orbitfb.physics.optics import Matrix

_USUAL = 0.3
"""Scatter of either value before the data [1]."""
_MOST = 0.8
"""ρ from which it is no memory: the orbit runs away [1]."""
_SHOWN = 10.0
"""Least information on a usual value, in its scatter: one that shows in nothing is left out."""
_ALIKE = 1e-6
"""Part of the information below which the two values are one: all modes have the same gain."""
_LEAST = 1.0
"""Gain of a memory up to which it is chance [nats]."""


def echoes(quick: Quick, white: Single) -> Single:
    """Tell what a memory makes of the innovations.

    Args:
        quick: The noise.
        white: Innovations of unit variance, shape (N, n).

    Returns:
        Changes of the innovations by the value that goes with L (1 − L) and by that with L²,
        shape (≤ 2, N n) [1]; without those of which these innovations show nothing, and none where
        the orbit runs away.
    """
    gains = quick.floor.gains
    steps = np.zeros_like(white)
    np.multiply(
        white[:-1], np.sqrt(quick.floor.innovation_variance), out=steps[1:], casting="same_kind"
    )
    echo = quick.follow(steps)
    shares = np.array([gains * (1.0 - gains), gains**2])
    pull = shares @ np.einsum("km,km->m", echo, white)
    known = (shares * np.einsum("km,km->m", echo, echo)) @ shares.T
    shown = np.diag(known) * _USUAL**2 > _SHOWN
    memory = float(_solved(known, pull, shown)[1])
    shown[1] &= memory > 0.0
    gain = 0.5 * float(pull @ _solved(known, pull, shown))
    told = shares[shown] if gain > _LEAST and memory < _MOST else shares[:0]
    return (echo * told.astype(np.float32)[:, None]).reshape(len(told), white.size)


def _solved(known: Matrix, pull: Vector, shown: Mask) -> Vector:
    """Best values of those that are shown, 0 of the others."""
    values = np.zeros_like(pull)
    values[shown] = np.linalg.lstsq(known[np.ix_(shown, shown)], pull[shown], rcond=_ALIKE)[0]
    return values
