"""Measure what learning costs, on one thread: `python -m benchmarks.learning_costs`.

Medians of repeats, 180 BPMs and correctors; of the tick-by-tick estimate the mean of a step. With
`--step` nothing else is measured. The tick's own costs are in `benchmarks.inference` and
`benchmarks.loop`.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse  # noqa: E402
import json  # noqa: E402
import time  # noqa: E402
from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from orbitfb.estimation.recursive.estimate import RecursiveResponse  # noqa: E402
from orbitfb.evaluate.simulate import ClosedLoop  # noqa: E402
from orbitfb.learn.builders import builder, first_policy  # noqa: E402
from orbitfb.learn.learner import Learner  # noqa: E402
from orbitfb.learn.settings import LearnSettings  # noqa: E402
from orbitfb.models.identify import Identifier  # noqa: E402
from orbitfb.models.naive import naive_least_squares  # noqa: E402
from orbitfb.models.rows import select_rows  # noqa: E402
from orbitfb.physics.places import Ring  # noqa: E402
from orbitfb.physics.plant import Plant, PlantSettings  # noqa: E402
from orbitfb.policies.adaptive_settings import TrackingSettings  # noqa: E402
from orbitfb.policies.embedding import embed, reembed  # noqa: E402
from orbitfb.policies.modal import ModalPolicy, ModalSettings  # noqa: E402
from orbitfb.policies.settings import PolicySettings  # noqa: E402
from orbitfb.policies.training.fine_tune import fine_tune  # noqa: E402

_STEPS, _RUNS = 600, 12


def median_of(work: Callable[[], object], repeats: int) -> float:
    """Seconds of one call, the median."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def recursive_step(groups: int, response: np.ndarray) -> tuple[float, float]:
    """Processor seconds of a reading and a prediction at rest, all that is learnt of them included.

    The loop is closed at the noise floor. Told are the mean of the quietest of some runs, each of
    many blocks in which the estimate learns, and the longest step of that run.
    """
    settings = TrackingSettings(groups=groups)
    recursive = RecursiveResponse(response, settings)
    rng, size = np.random.default_rng(0), len(response)
    inverse = np.linalg.inv(response)
    ground = settings.ground * np.sqrt(size) / np.linalg.norm(response) * response
    orbit, runs = np.zeros(size), []
    for _ in range(_RUNS + 1):  # the first one settles
        times = []
        for _ in range(_STEPS):
            reading = orbit + settings.reading_noise * rng.standard_normal(size)
            change = -inverse @ recursive.expected
            orbit = orbit + response @ change + ground @ rng.standard_normal(size)
            began = time.process_time()
            recursive.read(reading)
            recursive.predict(change)
            times.append(time.process_time() - began)
        runs.append((float(np.mean(times)), max(times)))
    return min(runs[1:])


def refit(kind: str) -> float:
    """Seconds from a hundred new transitions to a judged candidate."""
    settings = PolicySettings.model_validate({"kind": kind})
    plant = Plant(Ring.load(), "x", PlantSettings(), 1)
    policy = first_policy(plant.response, settings)
    loop = ClosedLoop(plant, policy, 700)
    learner = Learner(plant.response, LearnSettings(), builder(settings))
    loop.advance(200)
    learner.refit(loop.transitions(), policy, "periodic")
    times = []
    for _ in range(4):
        loop.advance(100)
        new = loop.transitions((learner.last_tick or 0) + 1)
        began = time.perf_counter()
        learner.refit(new, policy, "periodic")
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--step", action="store_true", help="only the tick-by-tick estimate")
    options = parser.parse_args()
    if options.step:
        for groups in (1, TrackingSettings().groups):
            mean, longest = recursive_step(
                groups, Plant(Ring.load(), "x", PlantSettings(), 1).response
            )
            print(f"{groups} groups: {1e6 * mean:.0f} µs a step, longest {1e6 * longest:.0f} µs")
        return
    import torch

    torch.set_num_threads(1)
    plant = Plant(Ring.load(), "x", PlantSettings(), 1)
    response = plant.response
    law = ModalPolicy(response, ModalSettings())
    network = embed(law)
    rows = select_rows(ClosedLoop(plant, law, 10_001).run().transitions(), 0.05)
    rng = np.random.default_rng(0)
    samples = response + 1e-6 * rng.standard_normal((32, *response.shape))
    identify = LearnSettings().identify
    as_used = recursive_step(TrackingSettings().groups, response)
    seconds = {
        "recursive step, one group of modes": recursive_step(1, response)[0],
        "recursive step, as used": as_used[0],
        "recursive step, as used, longest": as_used[1],
        "least squares of 10,000 transitions": median_of(lambda: naive_least_squares(rows), 5),
        "identification from 10,000 transitions": median_of(
            lambda: Identifier(response, identify).absorb(rows), 3
        ),
        "cautious modal law": median_of(lambda: ModalPolicy(response, ModalSettings()), 20),
        "embedding": median_of(lambda: embed(law), 20),
        "embedding, last layer alone": median_of(lambda: reembed(network, law), 20),
        "fine-tuning": median_of(lambda: fine_tune(network, samples, response=response), 3),
        **{f"refit and judge, {kind}": refit(kind) for kind in ("svd", "modal", "trajectory")},
    }
    for name, value in seconds.items():
        print(f"{name:<42} {1e3 * value:10.3f} ms")
    if options.output is not None:
        options.output.write_text(json.dumps(seconds, indent=1) + "\n")


if __name__ == "__main__":
    main()
