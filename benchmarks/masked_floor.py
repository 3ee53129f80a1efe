"""What masked BPMs cost a loop that knows everything.

    python -m benchmarks.masked_floor [--seeds 11,12,13,14,15,16]

The ring, the masks and the ticks are those of `python -m benchmarks.policies --masked SEEDS`. The
loop knows R, how the quadrupoles move the orbit, and the noise. Its estimate is the Kalman filter
of the disturbed orbit, and every change takes away what it expects of the next one: no law leaves
less. Told is the true orbit with masked BPMs over that without, of all seeds and of each.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from benchmarks.policies import LONG, MASKED, masked_bpms
from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.disturbances import QuadrupoleOrbits
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings


def step_covariance(settings: PlantSettings) -> Vector:
    """Give the covariance of what a tick of ground motion does to the orbit, shape (n, n) [m²]."""
    return settings.ground_motion_rms**2 * QuadrupoleOrbits(Ring.load(), "x").covariance()[0]


def floor(valid: Mask, steps: Vector, settings: PlantSettings) -> float:
    """Give the mean square of the true orbit over the second half of a run [m²].

    Args:
        valid: BPMs that are read, shape (n,).
        steps: Covariance of what a tick does, shape (n, n) [m²].
        settings: Of the ring.
    """
    keep = np.exp(-2.0 / settings.ground_motion_memory)
    noise = settings.bpm_noise_rms**2 * np.eye(int(np.count_nonzero(valid)))
    unknown, squares = np.zeros_like(steps), []
    for _ in range(LONG):
        squares.append(float(np.trace(unknown)) / len(valid))
        seen = unknown[valid]
        factor = cho_factor(seen[:, valid] + noise, lower=True, check_finite=False)
        unknown = unknown - seen.T @ cho_solve(factor, seen, check_finite=False)
        unknown = keep * unknown + steps
    return float(np.mean(squares[LONG // 2 :]))


def ratios(seeds: Sequence[int]) -> tuple[float, list[float]]:
    """Give the true orbit with masked BPMs over that with none, of all seeds and of each [1]."""
    settings = PlantSettings()
    steps = step_covariance(settings)
    none = floor(np.ones(len(steps), dtype=np.bool_), steps, settings)
    some = [floor(masked_bpms(len(steps), seed, MASKED), steps, settings) for seed in seeds]
    return float(np.sqrt(np.mean(some) / none)), [float(np.sqrt(one / none)) for one in some]


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="11,12,13,14,15,16", help="by commas")
    ratio, each = ratios([int(part) for part in parser.parse_args().seeds.split(",")])
    print(f"{'floor':<12}{ratio:6.3f}  " + " ".join(f"{part:.3f}" for part in each))


if __name__ == "__main__":
    main()
