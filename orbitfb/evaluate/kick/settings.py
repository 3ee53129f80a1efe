"""What a kick experiment is made of, and how wrong the controller's response is in it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Vector
from orbitfb.effects.settings import EffectSettings
from orbitfb.learn.settings import LearnSettings
from orbitfb.physics.drift import DriftSettings
from orbitfb.physics.effect import generator
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings

Law = Literal["svd", "told", "adaptive", "network", "told-network"]


class KickSettings(Settings):
    """What to run."""

    laws: tuple[Law, ...] = Field(
        default=("svd", "told", "adaptive", "network", "told-network"),
        min_length=1,
        description="Which laws, each on a ring of its own with the same kicks.",
    )
    error: Literal["none", "paper", "mild", "strong"] = Field(
        default="mild",
        description="The ring is, from the beginning, where this drift ends; the controllers have "
        "the R from before.",
    )
    matrix_error: float = Field(
        default=1e-6,
        ge=0,
        description="More error: independent, of every entry of the controllers' R, rms [m/A].",
    )
    prior: Literal["stated", "configured"] = Field(
        default="stated",
        description="What the learner believes of the error of its first R: its size as it is, or "
        "what `learn.identify` says.",
    )
    kicks: int = Field(default=8, ge=1, description="How many kicks.")
    kick_rms: float = Field(
        default=250e-6, gt=0, le=900e-6, description="Each kick at the BPMs, rms [m]."
    )
    window: int = Field(default=150, ge=20, description="Ticks between two kicks [ticks].")
    settle: int = Field(default=400, ge=50, description="Ticks before the first kick [ticks].")
    seed: int = Field(default=1, ge=0, description="Seed of ring, noise, errors and kicks.")
    planes: Planes = Field(default="x", description="Planes under feedback.")
    rate_hz: float = Field(default=50.0, gt=0, le=500, description="Ticks per second [Hz].")
    network_kind: Literal["modal", "network", "supervised", "trajectory"] = Field(
        default="network", description="What the laws `network` and `told-network` are."
    )
    policy: PolicySettings = Field(
        default=PolicySettings(), description="Settings of every kind; `kind` is not looked at."
    )
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")
    effects: tuple[EffectSettings, ...] = Field(
        default=(), description="Effects that the ring has besides."
    )

    @property
    def ticks(self) -> int:
        """Length of a run [ticks]."""
        return self.settle + self.kicks * self.window + 1

    def plant(self) -> PlantSettings:
        """Return what the ring suffers from: its drift is over after the first tick."""
        if self.error == "none":
            return PlantSettings()
        return PlantSettings(drift=DriftSettings.model_validate({"preset": self.error, "ticks": 1}))


@dataclass(frozen=True, slots=True)
class Responses:
    """The ring's response and the controllers'.

    Args:
        true: From the second tick on, shape (n, m) [m/A].
        believed: What the controllers begin with, shape (n, m) [m/A].
    """

    true: Vector
    believed: Vector

    def figures(self, policy: SvdSettings) -> dict[str, float]:
        """Say how wrong the controllers are.

        - `relative_error`: ‖believed − true‖ / ‖true‖, Frobenius [1];
        - `error_over_weakest`: spectral norm of the error over the smallest singular value of the
          true R [1]; above 1 the sign of the weakest mode is not known;
        - `growth_svd`: largest |eigenvalue| of 1 − R_true K of the SVD law on the believed R [1];
          above 1 that law loses its hold.

        Args:
            policy: Of the SVD law.
        """
        error = self.believed - self.true
        weakest = float(np.linalg.svd(self.true, compute_uv=False)[-1])
        closed = np.eye(len(self.true)) - self.true @ SvdPolicy(self.believed, policy).gain_matrix
        return {
            "relative_error": float(np.linalg.norm(error) / np.linalg.norm(self.true)),
            "error_over_weakest": float(np.linalg.norm(error, 2)) / weakest,
            "growth_svd": float(np.abs(np.linalg.eigvals(closed)).max()),
        }

    def error_scales(self, settings: "KickSettings") -> tuple[float, float]:
        """Split the error into the two parts that the learner's prior knows.

        Args:
            settings: The experiment.

        Returns:
            Rms of the part that is independent from entry to entry [m/A], known from the
            settings, and of the rest relative to R [1].
        """
        drawn = settings.plant().drift.matrix_noise
        entry = float(np.sqrt(settings.matrix_error**2 + 2.0 * drawn**2))
        filled = self.true != 0
        rest = np.mean((self.believed - self.true)[filled] ** 2) - entry**2
        size = np.mean(self.true[filled] ** 2)
        return entry, float(np.sqrt(max(0.0, rest) / size))


def responses(settings: KickSettings) -> Responses:
    """Give the ring's response and the controllers', the same for every law.

    Args:
        settings: The experiment.
    """
    plant = Plant(Ring.load(), settings.planes, settings.plant(), settings.seed)
    before, true = plant.response_at(0), plant.response_at(1)
    rng = generator(settings.seed, "controller's response")
    drawn = rng.standard_normal(before.shape)
    return Responses(true, before + settings.matrix_error * drawn * (true != 0))
