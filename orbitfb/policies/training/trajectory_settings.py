"""Settings of training through the system model, and what they make of the n-th iteration."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field, model_validator

from orbitfb.core.settings import Settings
from orbitfb.policies.training.coordinates import CoordinatesName

Loss = Literal["rms", "relative", "log"]
"""Cost of an orbit: its rms; its rms over that of the first orbit; the logarithm of its rms."""

Trained = Literal["all", "last", "output", "spare"]
"""What is trained: every matrix; the last; the changes' mixing behind it; only unused units."""

PerMode = Literal["far", "floor", "threshold"]


class RolloutSettings(Settings):
    """The trajectories that a policy is trained on, and what they cost."""

    horizon: int = Field(default=5, ge=1, le=1000, description="Steps N of a trajectory [1].")
    batch: int = Field(default=64, ge=1, description="Trajectories per iteration [1].")
    discount: float = Field(
        default=1.0, gt=0.0, le=1.0, description="γ: weight of a step over that before it [1]."
    )
    loss: Loss = Field(
        default="relative",
        description="Cost of an orbit: rms (the paper's −reward, in units of `amplitude`); "
        "relative (over the rms of the first orbit); log (the logarithm of the rms over "
        "`amplitude`).",
    )
    log_floor: float = Field(
        default=1e-9, gt=0.0, description="Added in squares to the rms under the logarithm [m]."
    )
    amplitude: float = Field(
        default=0.25e-3, gt=0.0, description="Largest rms of the first orbits, white [m]."
    )
    smallest_amplitude: float | None = Field(
        default=0.25e-6,
        gt=0.0,
        description="Smallest rms of the first orbits: log-uniform from here to `amplitude` [m]; "
        "unset: all at `amplitude`.",
    )
    reading_noise: float = Field(
        default=0.0, ge=0.0, description="Noise of the readings that the policy sees, rms [m]."
    )
    orbit_noise: float = Field(
        default=0.0, ge=0.0, description="White motion of the orbit between two steps, rms [m]."
    )
    kick_noise: float = Field(
        default=0.0,
        ge=0.0,
        description="Motion of the orbit between two steps by random changes of all correctors, "
        "rms of the orbit [m].",
    )
    change_cost: float = Field(
        default=0.0, ge=0.0, description="Cost of the rms of a change, as orbit rms [m/A]."
    )
    setpoint_cost: float = Field(
        default=0.0,
        ge=0.0,
        description="Cost of the rms of the summed changes, as orbit rms [m/A].",
    )
    horizon_curriculum: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Share of the iterations over which the horizon grows from 1 [1]; 0: at once.",
    )
    amplitude_curriculum: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Share of the iterations over which the smallest amplitude falls from the "
        "largest [1]; 0: at once.",
    )

    @model_validator(mode="after")
    def _check_amplitudes(self) -> "RolloutSettings":
        if self.smallest_amplitude is not None and self.smallest_amplitude > self.amplitude:
            raise ValueError("smallest_amplitude is above amplitude")
        return self


class DescentSettings(RolloutSettings):
    """How the loss of the trajectories is brought down."""

    iterations: int = Field(default=200, ge=0, description="Steps of Adam [1].")
    learning_rate: float = Field(default=1e-3, gt=0.0, description="Learning rate of Adam [1].")
    final_learning_rate: float | None = Field(
        default=1e-4,
        gt=0.0,
        description="Learning rate of the last iteration, reached along half a cosine [1]; unset: "
        "it stays.",
    )
    clip: float | None = Field(
        default=1.0, gt=0.0, description="Largest norm of the gradient [1]; unset: any."
    )
    seed: int = Field(default=0, ge=0, description="Seed of all draws [1].")


class NetworkDescentSettings(DescentSettings):
    """In what form a network is trained, and which part of it."""

    coordinates: CoordinatesName = Field(
        default="modes",
        description="raw: readings in, changes out (the paper); modes: along the singular vectors "
        "of the response matrix, every mode divided by its singular value.",
    )
    orbit_scale: float = Field(
        default=1e-3, gt=0.0, description="Orbit error that the network sees as 1 [m]."
    )
    change_scale: float = Field(
        default=20.0,
        gt=0.0,
        description="Change that the network calls 1, in raw coordinates [A] (20 A kick by about "
        "1 mrad).",
    )
    output_scale: float = Field(
        default=1.0,
        gt=0.0,
        description="Factor behind the last matrix; it scales a random start, and what a step of "
        "Adam does to the changes [1].",
    )
    trained: Trained = Field(
        default="all",
        description="What is trained: all matrices; last; output (a mixing of the changes, "
        "multiplied into the last matrix at the end); spare (the units that the start leaves "
        "unused, the others stay as they are).",
    )


class TrajectorySettings(NetworkDescentSettings):
    """Configuration of training a network through the system model (Algorithm 1).

    The defaults are the fast ones; `TrajectorySettings.paper()` is the published form.
    """

    hidden: int | None = Field(
        default=None,
        ge=1,
        description="Units per hidden layer [1]; unset: as the paper, 512 for 180 BPMs.",
    )
    first_output: float = Field(
        default=1.0,
        gt=0.0,
        description="Factor on the last matrix of a random start, and on nothing else [1].",
    )

    @classmethod
    def paper(cls, **values: Any) -> "TrajectorySettings":
        """Give Algorithm 1 as published: raw coordinates, random start, cost the rms.

        Args:
            values: Keys to be set otherwise.
        """
        published: dict[str, Any] = {
            "horizon": 10,
            "batch": 64,
            "discount": 0.99,
            "loss": "rms",
            "smallest_amplitude": None,
            "iterations": 1500,
            "learning_rate": 1e-4,
            "final_learning_rate": None,
            "clip": None,
            "coordinates": "raw",
            "first_output": 0.05,
        }
        return cls.model_validate({**published, **values})


class FineTuneSettings(NetworkDescentSettings):
    """Configuration of the improvement of a running network from its own weights."""

    horizon: int = Field(default=3, ge=1, le=1000, description="Steps N of a trajectory [1].")
    batch: int = Field(default=32, ge=1, description="Trajectories per iteration [1].")
    iterations: int = Field(default=20, ge=0, description="Steps of Adam [1].")
    learning_rate: float = Field(default=3e-4, gt=0.0, description="Learning rate of Adam [1].")
    final_learning_rate: float | None = Field(
        default=3e-5,
        gt=0.0,
        description="Learning rate of the last iteration, reached along half a cosine [1]; unset: "
        "it stays.",
    )
    trained: Trained = Field(
        default="last", description="What is trained: all, last, output or spare."
    )
    reading_noise: float = Field(
        default=0.2e-6, ge=0.0, description="Noise of the readings that the policy sees, rms [m]."
    )
    samples_per_iteration: int = Field(
        default=4, ge=1, description="Response matrices that an iteration sees, in turn [1]."
    )
    floor_tolerance: float = Field(
        default=1.01,
        ge=1.0,
        description="By what factor the noise floor, and the largest orbit, may grow at most for "
        "the trained network to be taken [1].",
    )
    judged_samples: int = Field(
        default=8, ge=1, description="Response matrices of the comparison, before and after [1]."
    )
    judged_steps: int = Field(
        default=60, ge=4, description="Steps of the comparison; its last half is the floor [1]."
    )


class StructuredSettings(DescentSettings):
    """Configuration of training the structured law: three numbers per mode."""

    horizon: int = Field(default=15, ge=1, le=1000, description="Steps N of a trajectory [1].")
    batch: int = Field(default=32, ge=1, description="Trajectories per iteration [1].")
    loss: Loss = Field(default="log", description="Cost of an orbit: rms, relative or log.")
    reading_noise: float = Field(
        default=0.2e-6, ge=0.0, description="Noise of the readings that the policy sees, rms [m]."
    )
    learning_rate: float = Field(default=2e-2, gt=0.0, description="Learning rate of Adam [1].")
    final_learning_rate: float | None = Field(
        default=2e-3,
        gt=0.0,
        description="Learning rate of the last iteration, reached along half a cosine [1]; unset: "
        "it stays.",
    )
    trained: tuple[PerMode, ...] = Field(
        default=("far", "floor", "threshold"),
        description="Which numbers of a mode are trained: far (gain far from zero), floor (gain "
        "at the noise floor), threshold (amplitude between them).",
    )


@dataclass(frozen=True, slots=True)
class Stage:
    """What an iteration of the curriculum asks for.

    Args:
        horizon: Steps of the trajectories [1].
        smallest: Smallest rms of the first orbits [m].
        largest: Largest rms of the first orbits [m].
    """

    horizon: int
    smallest: float
    largest: float


def stage(settings: RolloutSettings, iteration: int, iterations: int) -> Stage:
    """Give the stage of the curriculum.

    The horizon grows linearly from 1, the smallest amplitude falls geometrically from the
    largest.

    Args:
        settings: What the curriculum ends in, and how long it lasts.
        iteration: Which iteration, from 0.
        iterations: How many there are.
    """

    def progress(share: float) -> float:
        return 1.0 if share == 0.0 else min(1.0, iteration / (share * iterations))

    horizon = 1 + math.floor(progress(settings.horizon_curriculum) * (settings.horizon - 1))
    largest = settings.amplitude
    smallest = settings.smallest_amplitude or largest
    falling = (smallest / largest) ** progress(settings.amplitude_curriculum)
    return Stage(horizon, largest * falling, largest)
