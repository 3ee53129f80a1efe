"""Configuration of the policy that runs and of the candidates of every refit."""

from typing import Literal, Self

from pydantic import Field, JsonValue, field_validator, model_validator

from orbitfb.core.near_names import did_you_mean
from orbitfb.core.settings import Settings
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.modal import ModalSettings
from orbitfb.policies.network import NetworkSettings
from orbitfb.policies.store.kinds import TAKEN, Kind, added_kinds
from orbitfb.policies.svd import SvdSettings
from orbitfb.policies.training.supervised_settings import SupervisedSettings
from orbitfb.policies.training.trajectory_settings import FineTuneSettings

PolicyKind = Literal["svd", "modal", "adaptive", "network", "supervised", "trajectory"]
"""Kinds of this package."""

LINEAR = ("svd", "modal", "adaptive")
"""Kinds that are made of a matrix at once; others are trained, which takes minutes."""


class LiveModalSettings(ModalSettings):
    """The noise-aware law of a loop that runs on whatever the ring does.

    A ring whose weakest modes change their sign lost the beam without regularisation, even where
    the law was told the true response; and with the lowest gain that a quiet ring allows, its
    creep was not held.
    """

    regularisation: float = Field(
        default=1e-5, ge=0.0, description="Tikhonov λ, compared with the singular values [m/A]."
    )
    minimum_gain: float = Field(
        default=0.1, gt=0.0, le=1.0, description="Smallest gain of a mode at the noise floor [1]."
    )
    near_caution: float = Field(
        default=0.05,
        gt=0.0,
        le=1.0,
        description="Share of λ² and of the doubt about R̂ that counts at the noise floor [1].",
    )


class PolicySettings(Settings):
    """Which law runs, and of which refits make candidates."""

    kind: str = Field(
        default="svd",
        description="svd: the linear baseline; modal: a gain for every mode from its noise; "
        "adaptive: the response tracked at every tick, and a cautious gain of it; "
        "network: the same law in the paper's network; supervised: the network, trained on the "
        "answers of that law; trajectory: the network, improved by trajectory optimisation; or "
        "one that another package adds.",
    )
    caution: float = Field(
        default=1.0,
        ge=0.0,
        le=1.0,
        description="Share of the uncertainty of R̂ that lowers the gain of a candidate [1]; "
        "0: none.",
    )
    svd: SvdSettings = Field(default=SvdSettings(), description="The linear baseline.")
    modal: LiveModalSettings = Field(
        default=LiveModalSettings(),
        description="The noise-aware law, which the networks hold as well.",
    )
    adaptive: AdaptiveSettings = Field(
        default=AdaptiveSettings(), description="The law that learns while it acts."
    )
    network: NetworkSettings = Field(default=NetworkSettings(), description="The network.")
    supervised: SupervisedSettings = Field(
        default=SupervisedSettings(), description="Training of a network on answers of a law."
    )
    fine_tune: FineTuneSettings = Field(
        default=FineTuneSettings(),
        description="Trajectory optimisation of a candidate from the incumbent's weights.",
    )
    own: dict[str, JsonValue] = Field(
        default={},
        description="Settings of a kind that another package adds; it checks them.",
    )

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        known = (*TAKEN, *added_kinds())
        if kind not in known:
            hint = did_you_mean(kind, known)
            raise ValueError(
                f"there is no kind of policy {kind!r}{hint}; choose {', '.join(known)}"
            )
        return kind

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if self.kind in added_kinds():
            self.added()
        elif self.own:
            raise ValueError(
                f"own is for kinds that other packages add; {self.kind} has keys of its own"
            )
        return self

    def added(self) -> tuple[Kind, Settings]:
        """Give a kind that another package adds, and its settings.

        Raises:
            KeyError: The kind is of this package.
            ValidationError: The settings are wrong.
        """
        kind = added_kinds()[self.kind]
        return kind, kind.settings.model_validate(self.own)
