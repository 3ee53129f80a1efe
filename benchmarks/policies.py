"""Every policy against the SVD baseline, for its page: `python -m benchmarks.policies`.

All close the loop on the simulated ring from 250 µm, with its default noise and ground motion,
over the same seeds; nothing drifts and nothing learns. Writes benchmarks/policies.json, the
pictures of docs/explanations/policies and the table of measured.md there. With `--masked SEEDS`
it only tells, for every policy, what the seeds leave while BPMs are masked, and writes nothing.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orbitfb.config.tree import TrainSettings
from orbitfb.core.signals import Mask
from orbitfb.evaluate.compare import NEAR
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.response import response
from orbitfb.policies.adaptive import AdaptivePolicy
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.embedding import embed
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.policies.training.supervised import train_supervised
from orbitfb.policies.training.supervised_settings import SupervisedSettings
from orbitfb.policies.training.trajectory import train_trajectory

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs/explanations/policies"
FIGURES = ROOT / "benchmarks/policies.json"

TICKS, SEEDS, MASKED = 600, (1, 2, 3, 4), 9
LONG = 3000
"""Ticks of the loops with masked BPMs: what these do unseen takes minutes to show [ticks]."""
_UM = 1e6

NOTE = "This page is written by `python -m benchmarks.policies`.\n"
HEAD = f"""# Policies, measured side by side

{NOTE}
Closed loop on the simulated ring (x plane, default noise and ground motion, no drift) from
250 µm rms, {TICKS} ticks, seeds {SEEDS[0]} to {SEEDS[-1]}; nothing learns. *Floor*: rms of
the true and of the observed orbit over the second half and all seeds. *Steps*: median of the ticks
until the true orbit is within 0.05 mm rms. *Worst*: largest true orbit of any tick and seed.
*Masked*: the true floor at all BPMs while {MASKED} of them are masked, others for each seed, over
that with none, on a ring that begins corrected, in the second half of {LONG} ticks.
*Training*: processor seconds on one core of the machine that made the page.

| policy | true floor [µm] | observed floor [µm] | steps to 0.05 mm | worst [µm] | masked \
| training [s] |
|---|---|---|---|---|---|---|
"""


TAIL = """
What this says: on a ring that is known, the noise-aware law leaves a third less on the beam than
the baseline, and no training beats it, because it is the optimum there. Writing it into the network
costs nothing; training the network through the model keeps it. What learning is worth shows where
the ring is *not* known or drifts: [the paper's experiment](../paper.md),
[kicks](../../how-to/kick-the-ring.md).
"""


def policies() -> dict[str, tuple[Any, float]]:
    """Make every policy; the seconds are those of its training."""
    matrix = response(Ring.load(), "x")
    svd = SvdPolicy(matrix, SvdSettings())
    modal = ModalPolicy(matrix, ModalSettings())
    began = time.process_time()
    clone = train_supervised(matrix, SupervisedSettings(), teacher=svd, device="cpu")
    between = time.process_time()
    settings = TrainSettings().trajectory
    trained = train_trajectory(matrix, settings, start=embed(modal), device="cpu")
    ended = time.process_time()
    return {
        "svd": (svd, 0.0),
        "modal": (modal, 0.0),
        "adaptive": (AdaptivePolicy(matrix, AdaptiveSettings()), 0.0),
        "network": (embed(modal), 0.0),
        "supervised": (clone.policy, between - began),
        "trajectory": (trained.policy, ended - between),
    }


def masked_bpms(count: int, seed: int, masked: int) -> Mask:
    """Say which BPMs are valid while some are masked, others for each seed, shape (count,)."""
    valid = np.ones(count, dtype=np.bool_)
    valid[np.random.default_rng(seed).choice(count, masked, replace=False)] = False
    return valid


def loop_of(
    policy: Any, seed: int, masked: int = 0, initial: float = 250e-6, ticks: int = TICKS
) -> ClosedLoop:
    """Close the loop on a ring of its own, with some BPMs masked; a law that learns begins anew."""
    plant = Plant(Ring.load(), "x", PlantSettings(initial_orbit_rms=initial), seed)
    valid = masked_bpms(len(plant.nominal_response), seed, masked)
    if isinstance(policy, AdaptivePolicy):
        policy = AdaptivePolicy(plant.nominal_response, policy.settings)
    return ClosedLoop(plant, policy, ticks, ramp=1, valid=valid).run()


def masked_over_none(policy: Any, seeds: Sequence[int]) -> tuple[float, list[float]]:
    """Give the true floor with masked BPMs over that without, of all seeds and of each [1]."""
    with_none, with_some = (
        np.array([loop_of(policy, seed, count, 0.0, LONG).true_rms[LONG // 2 :] for seed in seeds])
        for count in (0, MASKED)
    )
    squares = np.mean(with_some**2, axis=1), np.mean(with_none**2, axis=1)
    each = np.sqrt(squares[0] / squares[1])
    return float(np.sqrt(np.mean(squares[0]) / np.mean(squares[1]))), each.tolist()


def run(policy: Any) -> dict[str, Any]:
    """Close the loop over all seeds."""
    loops = [loop_of(policy, seed) for seed in SEEDS]
    true = np.array([loop.true_rms for loop in loops])
    observed = np.array([loop.observed_rms for loop in loops])
    steps = [int(np.argmax(row <= NEAR)) if (row <= NEAR).any() else None for row in true]
    return {
        "true_floor_m": float(np.sqrt(np.mean(true[:, TICKS // 2 :] ** 2))),
        "masked_over_none": masked_over_none(policy, SEEDS)[0],
        "observed_floor_m": float(np.sqrt(np.mean(observed[:, TICKS // 2 :] ** 2))),
        "steps": steps,
        "worst_m": float(true.max()),
        "true_rms_m": np.sqrt(np.mean(true**2, axis=0)).tolist(),
    }


def draw(name: str, results: Mapping[str, Any], path: Path) -> None:
    """Draw one policy beside the baseline."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    start, whole = figure.subplots(1, 2, width_ratios=(1, 1.6), sharey=True)
    for law, colour in (("svd", "tab:grey"), (name, "tab:green")):
        curve = np.array(results[law]["true_rms_m"]) * _UM
        start.semilogy(np.arange(30), curve[:30], ".-", color=colour, lw=1)
        whole.semilogy(np.arange(TICKS), curve, color=colour, lw=1, label=law)
    start.set_ylabel("true orbit, rms over seeds and BPMs [µm]")
    start.set_xlabel("tick")
    whole.set_xlabel("tick")
    whole.legend()
    whole.set_title(f"{name} against svd, seeds {SEEDS[0]}–{SEEDS[-1]}")
    figure.savefig(path, dpi=90)


def table(results: Mapping[str, Any]) -> str:
    """Write the page."""
    lines = []
    for name, row in results.items():
        steps = [np.inf if step is None else step for step in row["steps"]]
        lines.append(
            f"| [{name}]({name}.md) | {row['true_floor_m'] * _UM:.4f} "
            f"| {row['observed_floor_m'] * _UM:.4f} | {np.median(steps):g} "
            f"| {row['worst_m'] * _UM:.1f} | {row['masked_over_none']:.3f} "
            f"| {row['training_seconds']:.1f} |\n"
        )
    return HEAD + "".join(lines) + TAIL


def main() -> None:
    """Measure, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--masked", metavar="SEEDS", help="by commas; nothing is written")
    options = parser.parse_args()
    if options.masked is not None:
        for name, (policy, _) in policies().items():
            ratio, each = masked_over_none(
                policy, [int(part) for part in options.masked.split(",")]
            )
            print(
                f"{name:<12}{ratio:6.3f}  " + " ".join(f"{part:.3f}" for part in each), flush=True
            )
        return
    results: dict[str, Any] = {}
    for name, (policy, seconds) in policies().items():
        results[name] = run(policy) | {"training_seconds": seconds}
        print(name, {k: v for k, v in results[name].items() if not k.startswith("true_rms")})
    FIGURES.write_text(json.dumps(results, indent=1) + "\n")
    PAGES.mkdir(exist_ok=True)
    for name in results:
        draw(name, results, PAGES / f"{name}.png")
    (PAGES / "measured.md").write_text(table(results))


if __name__ == "__main__":
    main()
