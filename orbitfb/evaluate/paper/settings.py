"""Settings of the paper's experiment."""

from typing import Literal

from pydantic import Field, field_validator

from orbitfb.core.settings import Settings
from orbitfb.evaluate.paper.methods import METHODS
from orbitfb.evaluate.paper.scenarios import NAMES, PLANE, SEED

QUICK_METHODS = tuple(name for name, method in METHODS.items() if method.quick)
MANY = 1000


class PaperSettings(Settings):
    """What to run."""

    scenarios: tuple[str, ...] = Field(
        default=("E2",), min_length=1, description=f"Scenarios: {', '.join(NAMES)}."
    )
    methods: tuple[str, ...] = Field(
        default=QUICK_METHODS, min_length=1, description="Methods, in the order of the table."
    )
    trajectories: int = Field(
        default=32, ge=1, le=100_000, description="Trajectories of each method [1]."
    )
    static_trajectories: int = Field(
        default=32, ge=1, le=100_000, description="Trajectories of each static method [1]."
    )
    steps: int = Field(
        default=10_000, ge=100, le=1_000_000, description="Length of the drift [ticks]."
    )
    after: int = Field(default=300, ge=0, description="Ticks after the re-kick [ticks].")
    plane: Literal["x", "y"] = Field(default=PLANE, description="Plane of the ring.")
    seed: int = Field(
        default=SEED, ge=0, description="Seed of ring errors and of all trajectories [1]."
    )
    device: Literal["auto", "cpu", "cuda"] = Field(
        default="auto", description="Where networks are trained."
    )

    @field_validator("scenarios")
    @classmethod
    def _check_scenarios(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return _known(names, NAMES)

    @field_validator("methods")
    @classmethod
    def _check_methods(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return _known(names, tuple(METHODS))


def _known(names: tuple[str, ...], choices: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in names if name not in choices]
    if unknown:
        raise ValueError(f"{', '.join(unknown)} is unknown; choose from {', '.join(choices)}")
    return tuple(name for name in choices if name in names)
