"""The diagnosis itself on the naive one-step residual: all is as it is but for the noise.

    python -m tests.blind.baselines.naive RECORD --out DIR [--holdout LATER] [--places … --ring …]

What is left of next − (orbit + R action) is taken as white, with a level for every BPM, in the
place of innovations of a Kalman filter. That is the filter of a floor whose walk is far above its
reading noise: its gain is 1, it believes every reading. The floor is estimated with the record
and with every cause, as the diagnosis does it.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.diagnose.run import diagnose_files
from orbitfb.diagnose.writing import write
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring

RATIO = 1e6
"""Walk over reading noise, both as variances: what is left of the filter's memory is 1 / RATIO."""
_LEAST = 1e-24
"""Variance of a BPM that tells the same all the time [m²]."""


def naive_floor(left: Matrix, starts: Mask, modes: NoiseModes) -> NoiseFloor:
    """Take the changes of every BPM for white; in the place of `floor.estimate_floor`.

    Args:
        left: What the model leaves, shape (N, n) [m].
        starts: Where stretches begin, shape (N,).
        modes: Not used: every BPM is by itself.
    """
    steps = np.diff(left, axis=0)[~starts[1:]]
    variance = np.maximum(np.mean(steps**2, axis=0), _LEAST)
    reading = float(np.median(variance)) / RATIO
    return NoiseFloor(NoiseModes.even(np.eye(len(modes.spread))), reading, variance)


@contextmanager
def naive() -> Iterator[None]:
    """Let every bench have the naive floor, each BPM with a variance of its own already."""
    with (
        patch("orbitfb.diagnose.bench.estimate_floor", naive_floor),
        patch("orbitfb.diagnose.bench.uneven", lambda left, starts, layout, floor: floor.modes),
    ):
        yield


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="Diagnose by the naive one-step residual.")
    parser.add_argument("record", type=Path)
    parser.add_argument("--holdout", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--places", type=Path)
    parser.add_argument("--ring", type=Path)
    options = parser.parse_args()
    with naive():
        answer = diagnose_files(
            options.record,
            None,
            options.holdout,
            planes=None,
            ring=Ring.load(options.places, options.ring),
            seed=0,
            progress=lambda what, share: None,
        )
    write(answer, options.out)


if __name__ == "__main__":
    main()
