"""Trajectory optimisation on the paper's forward net f(s, a) → s' − s instead of R̂.

Before the experiment the ring is explored in open loop: setpoints that move the orbit by 20 µm in
every direction that the known R reaches. A net is fitted to these transitions, validated on
others, and Algorithm 1, in the form that works, runs on it. One network serves all trajectories
and stays as it is.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Environment
from orbitfb.evaluate.paper.scenarios import Scenario
from orbitfb.evaluate.paper.trained import Trained, training_of
from orbitfb.models.forward.fit import fit_forward
from orbitfb.models.forward.settings import ForwardSettings
from orbitfb.models.rows import Rows
from orbitfb.nets.device import pick_device
from orbitfb.policies.inverse import regularised_inverse
from orbitfb.policies.training.trajectory import train_trajectory
from orbitfb.policies.training.trajectory_settings import TrajectorySettings

_AMPLITUDE = 20e-6
_REGULARISATION = 0.1
_TRAINING, _VALIDATION = 6000, 1500
_EXPLORE = 5


def forward_net(environment: Environment, device: str, residual: bool = True) -> Trained:
    """Train a network on a forward net.

    Args:
        environment: The trajectories.
        device: `auto`, `cpu` or `cuda`.
        residual: Whether the net adds to the known R, or learns all of it.
    """
    scenario = environment.scenario
    known = scenario.known(0)
    settings = ForwardSettings(residual=residual, reading_noise=scenario.reading_noise)
    model = fit_forward(
        explore(scenario, _TRAINING, 0), explore(scenario, _VALIDATION, 1), known, settings, device
    )
    result = train_trajectory(
        known,
        TrajectorySettings(reading_noise=scenario.reading_noise),
        model=model.torch_step(pick_device(device)),
        device=device,
    )
    trained = Trained(result)
    slope = np.linalg.norm(model.slope() - scenario.start) / np.linalg.norm(scenario.start)
    figures = {f"forward_{name}": float(value) for name, value in model.figures.items()}
    training = training_of(result)
    training["figures"] |= {**figures, "forward_relative_error": float(slope)}
    trained.training = training
    return trained


def forward_net_alone(environment: Environment, device: str) -> Trained:
    """Train a network on a forward net that learnt all of the response.

    Args:
        environment: The trajectories.
        device: `auto`, `cpu` or `cuda`.
    """
    return forward_net(environment, device, residual=False)


def explore(scenario: Scenario, ticks: int, part: int) -> Rows:
    """Record the ring in open loop at the start of the drift.

    Args:
        scenario: What happens.
        ticks: Length of the record [ticks].
        part: Number of the record: another one, other changes.
    """
    rng = np.random.default_rng([scenario.seed, part, _EXPLORE])
    n, m = scenario.start.shape
    law = regularised_inverse(scenario.known(0), _REGULARISATION)
    setpoints: Vector = _AMPLITUDE * rng.standard_normal((ticks + 1, n)) @ law.T
    changes = np.diff(setpoints, axis=0)
    orbits = setpoints @ scenario.start.T
    readings = orbits + scenario.reading_noise * rng.standard_normal((ticks + 1, n))
    return Rows(
        tick=np.arange(ticks),
        change=changes,
        dither=np.zeros((ticks, m)),
        difference=np.diff(readings, axis=0),
        valid=np.ones((ticks, n), dtype=np.bool_),
        starts=np.arange(ticks) == 0,
        closed=np.zeros(ticks, dtype=np.bool_),
        left_out={},
        orbit=readings[:-1],
    )
