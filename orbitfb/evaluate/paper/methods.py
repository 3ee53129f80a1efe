"""The methods of the paper's experiment, by name."""

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orbitfb.core.errors import ConfigError
from orbitfb.evaluate.paper.environment import Controller, Environment

_PAPER = "orbitfb.evaluate.paper"

EXTRAS: Mapping[str, tuple[str, ...]] = {"rl": ("gymnasium", "stable_baselines3")}
"""What has to be importable for an extra of the package."""


@dataclass(frozen=True, slots=True)
class Method:
    """One way of control.

    Args:
        title: What it is, for people.
        control: `module:function` of `orbitfb.evaluate.paper`; it takes the environment, by name
            the options, and `device` where it computes on one, and gives the controller.
        static: Whether it stays as it is while it runs; then many trajectories are cheap.
        quick: Whether it is part of `--quick`.
        whole: Whether all trajectories are run at once, because most of the work is common.
        cost: About how long 32 trajectories take, to start the longest first [s].
        on_device: Whether the function takes `device`.
        extra: Extra of the package that it needs; empty: none.
    """

    title: str
    control: str
    static: bool
    quick: bool = True
    whole: bool = False
    cost: float = 10.0
    on_device: bool = False
    extra: str = ""

    @property
    def installed(self) -> bool:
        """Whether its extra is installed."""
        return all(importlib.util.find_spec(name) for name in EXTRAS.get(self.extra, ()))

    def controller(
        self, environment: Environment, options: Mapping[str, Any], device: str
    ) -> Controller:
        """Make the controller.

        Args:
            environment: The trajectories.
            options: Of the function, by name.
            device: `auto`, `cpu` or `cuda`.
        """
        module, _, name = self.control.partition(":")
        function = getattr(importlib.import_module(f"{_PAPER}.{module}"), name)
        return function(environment, **options, **({"device": device} if self.on_device else {}))


METHODS: Mapping[str, Method] = {
    "svd": Method("SVD, the paper's λ", "laws:svd", static=True),
    "svd-best": Method("SVD, λ and gain the best in hindsight", "laws:svd", static=True),
    "modal-linear": Method("linear, Kalman gain of every mode", "laws:modal_linear", static=True),
    "modal": Method("Kalman gains at the floor, 1 far from it", "laws:modal", static=True),
    "supervised": Method(
        "network, supervised, the paper's budget",
        "trained:supervised",
        static=True,
        whole=True,
        cost=40.0,
        on_device=True,
    ),
    "supervised-right": Method(
        "network, supervised, done right",
        "trained:supervised_right",
        static=True,
        whole=True,
        cost=45.0,
        on_device=True,
    ),
    "naive-refit": Method(
        "SVD law on naive least squares, every 500 ticks",
        "naive:NaiveRefit",
        static=False,
        quick=False,
        cost=80.0,
    ),
    "model-based-rl-verbatim": Method(
        "network, Algorithm 1 and naive least squares, verbatim",
        "naive:Verbatim",
        static=False,
        quick=False,
        cost=600.0,
        on_device=True,
    ),
    "forward-net": Method(
        "network, trained on R̂ a + a forward net",
        "forward_net:forward_net",
        static=True,
        quick=False,
        whole=True,
        cost=150.0,
        on_device=True,
    ),
    "forward-net-alone": Method(
        "network, trained on a forward net alone",
        "forward_net:forward_net_alone",
        static=True,
        quick=False,
        whole=True,
        cost=150.0,
        on_device=True,
    ),
    "ppo": Method(
        "PPO of stable-baselines3, 20,000 steps in mode coordinates",
        "agent:Agent",
        static=True,
        quick=False,
        whole=True,
        cost=90.0,
        on_device=True,
        extra="rl",
    ),
    "adaptive-linear": Method(
        "recursive R̂ and cautious gain, linear",
        "adaptive:adaptive_linear",
        static=False,
        quick=False,
        cost=110.0,
    ),
    "model-based-rl": Method(
        "network, recursive R̂ and cautious gain",
        "adaptive:model_based_rl",
        static=False,
        cost=130.0,
    ),
    "model-based-rl-memoryless": Method(
        "network on raw readings, recursive R̂ and cautious gain",
        "adaptive:memoryless",
        static=False,
        quick=False,
        cost=130.0,
    ),
    "true-response": Method(
        "knows R_t: the bound", "bound:TrueResponse", static=False, whole=True, cost=25.0
    ),
}
"""In the order of the table."""

HINDSIGHT = "svd-best"
"""Not run as it stands: the options with the best end over `GRID` are found first."""

GRID: tuple[Mapping[str, float], ...] = tuple(
    {"regularisation": regularisation, "gain": gain}
    for gain in (1.0, 0.3, 0.1, 0.05, 0.03)
    for regularisation in (1e-3, 1e-2, 0.1, 1.0, 3.0, 10.0, 33.6, 100.0, 1000.0)
)
"""λ [(m/rad)²] and gain [1] among which the best is looked for."""


def find_method(name: str) -> Method:
    """Look up a method.

    Raises:
        ConfigError: There is none of this name.
    """
    if name not in METHODS:
        raise ConfigError(f"there is no method {name!r}: choose from {', '.join(METHODS)}")
    return METHODS[name]
