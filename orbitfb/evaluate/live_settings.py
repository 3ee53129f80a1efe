"""What to run in the real loop on a drifting ring."""

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.effects.settings import EffectSettings
from orbitfb.learn.settings import LearnSettings
from orbitfb.physics.drift import DriftSettings, Preset
from orbitfb.physics.places import Planes
from orbitfb.physics.plant import PlantSettings
from orbitfb.policies.settings import PolicySettings


class LiveSettings(Settings):
    """What to run."""

    drift: Preset = Field(default="strong", description="Drift of the ring over the whole run.")
    ticks: int = Field(default=6000, ge=200, description="Length of each run [ticks].")
    seed: int = Field(default=1, ge=0, description="Seed of ring, noise and drift.")
    planes: Planes = Field(default="x", description="Planes under feedback.")
    rate_hz: float | None = Field(
        default=None, gt=0, le=500, description="Ticks per second [Hz]; unset: in lockstep."
    )
    policy: PolicySettings = Field(
        default=PolicySettings(), description="Kind and settings of all the laws."
    )
    effects: tuple[EffectSettings, ...] = Field(
        default=(), description="Effects that the ring has besides."
    )
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")

    def plant(self) -> PlantSettings:
        """Return what the ring suffers from."""
        if self.drift == "none":
            return PlantSettings()
        drift = {"preset": self.drift, "ticks": self.ticks}
        return PlantSettings(drift=DriftSettings.model_validate(drift))


def informed(policy: PolicySettings) -> PolicySettings:
    """Say which law is told R beside a law: the same; for one that learns, the noise-aware one."""
    return policy.model_copy(update={"kind": "modal"}) if policy.kind == "adaptive" else policy
