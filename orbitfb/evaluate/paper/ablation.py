"""What each part of the adaptive method is worth: the same runs, with one part left out at a time.

A row is a variant of a method in a scenario; its options are those of `AdaptiveSettings`.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from orbitfb.evaluate.paper.environment import Environment, simulate
from orbitfb.evaluate.paper.methods import find_method
from orbitfb.evaluate.paper.metrics import figures, summarise
from orbitfb.evaluate.paper.scenarios import PLANE, SEED, make_scenario
from orbitfb.physics.places import Plane

_LINEAR, _NETWORK = "adaptive-linear", "model-based-rl"

VARIANTS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "all": (_LINEAR, {}),
    "written as the network": (_NETWORK, {}),
    "network on raw readings": ("model-based-rl-memoryless", {}),
    "no noise model": (_LINEAR, {"noise_model": False}),
    "no filter in the law": (_LINEAR, {"filtered": False}),
    "no prior": (_LINEAR, {"prior": False}),
    "no drift": (_LINEAR, {"drift": False}),
    "no caution": (_LINEAR, {"caution": False}),
    "one gain near and far": (_LINEAR, {"near_far": False}),
    "no events": (_LINEAR, {"events": False}),
    "no creep": (_LINEAR, {"creep": False}),
    "dither 0.03 µm": (_LINEAR, {"dither": 0.03e-6}),
}
"""Method and options of each variant."""

SENSITIVITIES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    f"{name}_factor {factor:g}": (_LINEAR, {f"{name}_factor": factor})
    for name in ("noise", "error", "drift", "ground")
    for factor in (0.5, 2.0)
}
"""What is known beforehand, half and twice what is true."""


def ablation(
    scenarios: Iterable[str],
    trajectories: int = 8,
    steps: int = 10_000,
    after: int = 300,
    plane: Plane = PLANE,
    seed: int = SEED,
    variants: Mapping[str, tuple[str, Mapping[str, Any]]] = VARIANTS,
    progress: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """Run every variant in every scenario.

    Args:
        scenarios: Their names.
        trajectories: Trajectories of each row.
        steps: Length of the drift [ticks].
        after: Ticks after the re-kick [ticks].
        plane: `x` or `y`.
        seed: Of ring errors and trajectories.
        variants: Method and options by name.
        progress: Told of each row before it is run.

    Returns:
        Rows for JSON: scenario, variant, method, options, plane, seed, steps, the figures of
        `metrics.figures`, and `swaps_per_tick`, how often the gain was renewed.
    """
    rows: list[dict[str, Any]] = []
    for name in scenarios:
        scenario = make_scenario(name, plane=plane, seed=seed, steps=steps, after=after)
        for variant, (method, options) in variants.items():
            if progress is not None:
                progress(f"{name}: {variant}")
            made: list[Any] = []

            def control(
                environment: Environment,
                method: str = method,
                options: Mapping[str, Any] = options,
                made: list[Any] = made,
            ) -> Any:
                made.append(find_method(method).controller(environment, options, "cpu"))
                return made[-1]

            curves = simulate(scenario, range(trajectories), control)
            swaps = np.mean([loop.gain.swaps for loop in made[0].loops])
            rows.append(
                {
                    "scenario": name,
                    "variant": variant,
                    "method": method,
                    "options": dict(options),
                    "plane": plane,
                    "seed": seed,
                    "steps": steps,
                    "swaps_per_tick": float(swaps) / (steps + after),
                    **figures(summarise(curves, steps), scenario),
                }
            )
    return rows
