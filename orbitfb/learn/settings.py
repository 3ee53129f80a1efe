"""Configuration of the learner."""

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.models.settings import IdentifySettings


class JudgeSettings(Settings):
    """What a candidate must show before it may act."""

    samples: int = Field(
        default=6,
        ge=1,
        le=64,
        description="Responses drawn from the posterior for the judgement [1].",
    )
    horizon: int = Field(
        default=512,
        ge=16,
        le=8192,
        description="Ticks ahead for which the orbit is predicted [ticks].",
    )
    margin: float = Field(
        default=0.002,
        ge=0.0,
        lt=1.0,
        description="Least predicted gain in true-orbit rms, a ratio [1].",
    )
    slowest_growth: float = Field(
        default=1.01,
        gt=0.0,
        description="Largest growth of the orbit per tick on any drawn response [1].",
    )
    evidence: float = Field(
        default=10.0,
        ge=0.0,
        description="Refuse when the rows spoke against R̂ by more than this log-likelihood [nats].",
    )
    change_limit: float = Field(
        default=1.0, gt=0.0, description="Largest rms change of setpoints for `change_orbit` [A]."
    )
    change_orbit: float = Field(
        default=100e-6,
        gt=0.0,
        description="White orbit error at which `change_limit` holds, rms [m].",
    )


class LearnSettings(Settings):
    """Configuration of the background learner."""

    enabled: bool = Field(default=True, description="Whether the learner runs beside the loop.")
    every: int = Field(default=100, ge=1, description="Ticks between two periodic refits [ticks].")
    check: int = Field(
        default=20,
        ge=1,
        description="Ticks between two looks at the innovations and the orbit [ticks].",
    )
    minimum_rows: int = Field(
        default=40, ge=1, description="Fewest new rows from which a candidate may be built [1]."
    )
    chi2_trigger: float = Field(
        default=1.3,
        gt=1.0,
        description="Mean squared normalised innovation of the running policy's response that "
        "brings a refit forward [1].",
    )
    cautious: bool = Field(
        default=True, description="Whether the uncertainty of R̂ lowers the gain of the candidate."
    )
    tolerance: float = Field(
        default=0.05,
        gt=0.0,
        description="Largest |readback − setpoint| of a row that may teach [A].",
    )
    watch: int = Field(
        default=100, ge=1, description="Ticks for which the orbit is watched after a swap [ticks]."
    )
    rollback_factor: float = Field(
        default=2.0,
        gt=1.0,
        description="Observed orbit rms after over before a swap that is too much [1].",
    )
    rollback_ticks: int = Field(
        default=5,
        ge=1,
        description="Ticks in a row beyond `rollback_factor` that roll back [ticks].",
    )
    identify: IdentifySettings = Field(
        default=IdentifySettings(), description="Identification of R̂: prior, drift, noise."
    )
    judge: JudgeSettings = Field(default=JudgeSettings(), description="Acceptance of candidates.")
