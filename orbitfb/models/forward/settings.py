"""Configuration of the forward net."""

from typing import Literal

from pydantic import Field

from orbitfb.core.settings import Settings


class ForwardSettings(Settings):
    """Configuration of the forward net f(s, a) → s' − s."""

    hidden: tuple[int, ...] = Field(
        default=(128,), min_length=1, max_length=6, description="Widths of the hidden layers [1]."
    )
    members: int = Field(default=4, ge=1, le=64, description="Nets of the ensemble [1].")
    residual: bool = Field(
        default=True,
        description="Whether a net adds to R̂ a and begins at zero, or must learn all of it.",
    )
    window: int = Field(
        default=128,
        ge=1,
        le=2048,
        description="Rows over which prediction errors are filtered to innovations; 1: the plain "
        "one-step error, which is biased in closed loop [1].",
    )
    bootstrap: bool = Field(
        default=True,
        description="Whether each net gets windows drawn with replacement, besides its own seed.",
    )
    iterations: int = Field(default=400, ge=1, description="Steps of the optimiser [1].")
    batch: int = Field(default=1024, ge=1, description="Rows of a step, about [1].")
    learning_rate: float = Field(
        default=2e-3, gt=0.0, description="Of Adam at first; it falls to zero along a cosine [1]."
    )
    belief: float = Field(
        default=3000.0,
        ge=0.0,
        description="Rows that the belief in a zero answer of the nets is worth (in the residual "
        "form: the belief in R̂) [1].",
    )
    seed: int = Field(default=0, ge=0, description="Seed of weights and draws [1].")
    reading_noise: float = Field(
        default=0.2e-6, gt=0.0, description="BPM noise to believe before there are data, rms [m]."
    )
    ground: float = Field(
        default=0.04e-6,
        gt=0.0,
        description="Orbit motion per tick to believe before there are data, rms [m].",
    )
    device: Literal["auto", "cpu", "cuda"] = Field(
        default="auto", description="Where it is trained."
    )
    other_share: float = Field(
        default=0.01,
        gt=0.0,
        lt=1.0,
        description="Least share of the motion in the validation rows that the law of the "
        "training rows does not explain [1].",
    )
    slope_tolerance: float = Field(
        default=0.1,
        gt=0.0,
        description="Largest deviation from 1 of the slope of a net's answer on the true one that "
        "is trusted [1].",
    )
    chi2_tolerance: float = Field(
        default=1.03,
        ge=1.0,
        description="Largest mean squared innovation of a net that is trusted, over that of R̂ "
        "alone [1].",
    )
