"""Identify R from 10,000 rows of a quiet loop, old and new side by side.

    python -m benchmarks.identification [--rows 10000] [--gains 0.3,0.5,1.0] [--seed 3] [--out FILE]

For every loop gain one record of the simulated ring, plane x, 180 × 180, without drift; R̂ begins
with an error drawn from the prior. On the same record, in one run:

- `before`: the recursion block by block (`benchmarks.block_by_block`);
- `now`: sums of chunks and one solution (`orbitfb.models.identify`).

Told are processor seconds on one thread, the slope of R̂ on R over the directions that the loop
excited (1 when unbiased), the errors of R̂ in units of the stated ones (rms, and the share within
two of them), and the distance of the two R̂ in units of the two intervals together. Then what a
refit costs in the service: a hundred new rows, R̂, a candidate, the judgement.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse  # noqa: E402
import json  # noqa: E402
import time  # noqa: E402
from collections.abc import Callable, Mapping  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.block_by_block import BlockByBlock  # noqa: E402
from orbitfb.core.signals import Vector  # noqa: E402
from orbitfb.estimation.statistics import (  # noqa: E402
    LONGEST,
    StepSpectrum,
    StepStatistics,
    solve,
)
from orbitfb.evaluate.simulate import ClosedLoop  # noqa: E402
from orbitfb.learn.builders import builder  # noqa: E402
from orbitfb.learn.learner import Learner  # noqa: E402
from orbitfb.learn.settings import LearnSettings  # noqa: E402
from orbitfb.models.belief import WEIGHTS  # noqa: E402
from orbitfb.models.identify import Identifier  # noqa: E402
from orbitfb.models.linear import LinearModel, excited_gain  # noqa: E402
from orbitfb.models.rows import Rows, select_rows  # noqa: E402
from orbitfb.models.settings import IdentifySettings  # noqa: E402
from orbitfb.physics.places import Ring  # noqa: E402
from orbitfb.physics.plant import Plant  # noqa: E402
from orbitfb.policies.settings import PolicySettings  # noqa: E402
from orbitfb.policies.svd import SvdPolicy, SvdSettings  # noqa: E402

_SETTLE = 300
"""Ticks after which the loop is at its noise floor."""
_REPEATS = 5


def spent(work: Callable[[], object]) -> float:
    """Processor seconds of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def drawn(response: Vector, settings: IdentifySettings, seed: int) -> Vector:
    """Draw a first response from the prior around the true one."""
    generator = np.random.default_rng(seed + 50)
    size = len(response)
    relative = generator.standard_normal((size, size)) @ response / np.sqrt(size)
    entries = generator.standard_normal(response.shape)
    return response + settings.prior_entry * entries + settings.prior_relative * relative


def chunk_costs(rows: Rows, model: LinearModel, first: Vector) -> tuple[float, float]:
    """Processor seconds of all sums, and of one solution from them (the median of some)."""
    regressors = np.column_stack([rows.change, np.ones(len(rows))])
    steps = (rows.difference - rows.change @ first.T) @ model.modes
    statistics = StepStatistics(regressors.shape[1], len(first))

    def sum_up() -> None:
        for begin in range(0, len(rows), LONGEST):
            piece = slice(begin, begin + LONGEST)
            statistics.take(StepSpectrum.of(regressors[piece], steps[piece], rows.starts[piece]))

    summed = spent(sum_up)
    prior = np.pad(1e-12 * np.eye(len(first)) + 4e-4 * first.T @ first / len(first), (0, 1))
    prior[-1, -1] = 25e-18
    times = [
        spent(lambda: solve([statistics], prior, WEIGHTS, model.levels, model.reading_variance))
        for _ in range(_REPEATS)
    ]
    return summed, float(np.median(times))


def quality(model: LinearModel, truth: Vector, changes: Vector) -> dict[str, float]:
    """Bias and intervals of an estimate."""
    errors = model.normalised_errors(truth)
    return {
        "gain": excited_gain(model.response, truth, changes),
        "normalised error": float(np.sqrt(np.mean(errors**2))),
        "within 2 sigma": float(np.mean(np.abs(errors) < 2.0)),
        "relative error": float(np.linalg.norm(model.response - truth) / np.linalg.norm(truth)),
    }


def distance(one: LinearModel, other: LinearModel) -> float:
    """Rms distance of two R̂ in units of both intervals together, entry by entry."""
    variance = np.diag(one.row_covariance) + np.diag(other.row_covariance)
    return float(np.sqrt(np.mean((one.response - other.response) ** 2 / variance)))


def compare(gain: float, count: int, seed: int) -> Mapping[str, float]:
    """Old and new on one record."""
    settings = IdentifySettings()
    plant = Plant(Ring.load(), "x", seed=seed)
    truth = plant.response
    first = drawn(truth, settings, seed)
    loop = ClosedLoop(plant, SvdPolicy(first, SvdSettings(gain=gain)), count + 1).run()
    rows = select_rows(loop.transitions(), 1e-6)
    changes = loop.applied(_SETTLE)
    before, now = BlockByBlock(first, settings), Identifier(first, settings)
    seconds = {
        "seconds before": spent(lambda: before.absorb(rows)),
        "seconds now": spent(lambda: (now.absorb(rows), now.model)),
    }
    summed, solved = chunk_costs(rows, now.model, first)
    figures = {"seconds now, sums alone": summed, "seconds now, from the sums to R": solved}
    for name, model in (("before", before.model), ("now", now.model)):
        found = quality(model, truth, changes)
        figures |= {f"{key} {name}": value for key, value in found.items()}
    return {**seconds, **figures, "distance": distance(before.model, now.model)}


def refit_seconds(seed: int) -> float:
    """Processor seconds from a hundred new transitions to a judged candidate, the median."""
    plant = Plant(Ring.load(), "x", seed=seed)
    policy = SvdPolicy(plant.response, SvdSettings())
    loop = ClosedLoop(plant, policy, 900)
    learner = Learner(plant.response, LearnSettings(), builder(PolicySettings()))
    loop.advance(200)
    learner.refit(loop.transitions(), policy, "periodic")
    times: list[float] = []
    while loop.tick < 900:
        loop.advance(100)
        learner.absorb(loop.transitions((learner.last_tick or 0) + 1), policy)
        times.append(spent(lambda: learner.conclude(policy, "periodic")))
    return float(np.median(times))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000, help="of a record")
    parser.add_argument("--gains", default="0.3,0.5,1.0", help="loop gains, by commas")
    parser.add_argument("--seed", type=int, default=3, help="of ring, noise and first response")
    parser.add_argument("--out", type=Path, help="where the figures go as JSON")
    options = parser.parse_args()
    gains = [float(gain) for gain in options.gains.split(",")]
    found = {gain: compare(gain, options.rows, options.seed) for gain in gains}
    print(f"{'loop gain':<34}" + "".join(f"{gain:>12g}" for gain in gains))
    for name in found[gains[0]]:
        print(f"{name:<34}" + "".join(f"{found[gain][name]:12.4f}" for gain in gains))
    refit = refit_seconds(options.seed)
    print(f"{'seconds of a refit with judgement':<34}{refit:12.4f}")
    if options.out is not None:
        document = {
            "command": f"python -m benchmarks.identification --rows {options.rows} "
            f"--gains {options.gains} --seed {options.seed}",
            "gains": {f"{gain:g}": dict(figures) for gain, figures in found.items()},
            "refit seconds": refit,
        }
        options.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
