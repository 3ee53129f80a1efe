"""BPMs of unequal noise: how much noisier each is than the usual one, of the record itself.

What a BPM reads beyond what all others make likely is its reading noise, nearly (the diagonal of
the inverse covariance). Its median square over the rows leaves bursts out, and the middle of all
BPMs says how far healthy ones differ: a few that stand out from that are a finding, no floor.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.floor import estimate_floor
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Layout

_EVEN = 0.15
"""Scatter of the logarithm of a variance up to which all BPMs are taken as alike."""
_MEDIAN_SQUARE = 0.4549
"""Of a normal variable of unit variance."""
_CHANCE = 2.33
"""Standard deviation of the logarithm of the median of N squares, times √N."""
_TAIL = 0.1
"""Share of the BPMs at either end that may be findings."""
_TAIL_AT = 1.2816
"""Standard deviations from the mean at which the tails of a normal distribution begin."""
_FARTHEST = 2.0
"""Standard deviations of healthy BPMs up to which a BPM's noise is its own."""
_ROUNDS = 3
_FEWEST_BPMS, _FEWEST_ROWS = 20, 200


def uneven(left: Matrix, starts: Mask, layout: Layout, floor: NoiseFloor) -> NoiseModes:
    """Find the modes of BPMs that differ in noise; those of the floor if they do not.

    Args:
        left: What the model and healthy errors leave, shape (N, n) [m].
        starts: Where stretches begin, shape (N,).
        layout: Devices.
        floor: As estimated for BPMs that are alike.
    """
    if left.shape[1] < _FEWEST_BPMS or len(left) < _FEWEST_ROWS:
        return floor.modes
    for _ in range(_ROUNDS):
        logs = np.log(_ratios(left, starts, floor)) + 2.0 * np.log(floor.modes.spread)
        logs -= np.median(logs)
        ends = np.quantile(logs, [_TAIL, 1.0 - _TAIL])
        chance = _CHANCE**2 / len(left)
        healthy = (float(np.ptp(ends)) / (2.0 * _TAIL_AT)) ** 2 - chance
        if healthy < _EVEN**2:
            break
        far = _FARTHEST * float(np.sqrt(healthy))
        own = np.clip(logs * healthy / (healthy + chance), -far, far)
        spread = np.exp(0.5 * (own - own.mean()))
        scatter, ground = float(np.sqrt(healthy)), floor.modes.ground
        modes = NoiseModes.of(layout, spread, scatter, ground=ground)
        floor = estimate_floor(left, starts, modes)
    return floor.modes


def _ratios(left: Matrix, starts: Mask, floor: NoiseFloor) -> Vector:
    """Variance of what every BPM reads beyond the others over what the floor says, (n,)."""
    white = floor.whiten(left, starts)[~starts]
    modal = floor.modes.directions.T / np.sqrt(floor.innovation_variance)[:, None]
    middle = np.median((white @ modal) ** 2, axis=0)
    return np.maximum(middle / np.sum(modal**2, axis=0) / _MEDIAN_SQUARE, 1e-6)
