"""Configuration of the learner."""

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.models.settings import ChangeSettings, IdentifySettings


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
    simulated_ticks: int = Field(
        default=160,
        ge=16,
        le=8192,
        description="Ticks at rest for which a law that is not linear is simulated [ticks].",
    )
    recovery_ticks: int = Field(
        default=12,
        ge=1,
        le=1024,
        description="Ticks after a kick for which a law that is not linear is simulated [ticks].",
    )
    slowest_recovery: float = Field(
        default=0.5,
        gt=0.0,
        description="Largest part of a kick that may be left after `recovery_ticks`, unless the "
        "incumbent leaves more [1].",
    )
    highest_peak: float = Field(
        default=2.0,
        gt=0.0,
        description="Largest orbit after a kick over the kick, unless the incumbent makes a "
        "larger one [1].",
    )
    margin: float | None = Field(
        default=None,
        ge=0.0,
        lt=1.0,
        description=(
            "Least predicted gain in true-orbit rms, a ratio [1]; none: the cost of a swap."
        ),
    )
    resolved: bool = Field(
        default=True,
        description="Whether the gain must be resolved: larger than `margin` on 95 % of the "
        "responses that the data allow, or the rows refute the incumbent's response.",
    )
    slowest_growth: float = Field(
        default=1.01,
        gt=0.0,
        description="Largest growth of the orbit per tick on any drawn response [1].",
    )
    evidence: float = Field(
        default=10.0,
        ge=0.0,
        description="Log-likelihood by which rows refute a response: R̂, since the last judgement, "
        "or that of the incumbent, since it is in force [nats].",
    )
    change_limit: float = Field(
        default=1.0,
        gt=0.0,
        description="Largest rms change of setpoints for `change_orbit`, unless the incumbent "
        "makes a larger one, or R̂, as far as it is known, needs one to correct that orbit [A].",
    )
    change_orbit: float = Field(
        default=100e-6,
        gt=0.0,
        description="White orbit error at which `change_limit` holds; also the kick of the "
        "simulation, rms [m].",
    )


class ShadowSettings(Settings):
    """What a candidate must show beside the incumbent, on live orbits, before it acts."""

    ticks: int = Field(
        default=20,
        ge=0,
        description="Closed ticks for which an accepted candidate runs in shadow [ticks]; 0: none.",
    )
    margin: float = Field(
        default=0.05,
        ge=0.0,
        description="By how much the orbit that it would have made may be larger than that of the "
        "incumbent, rms, a ratio [1].",
    )
    patience: float = Field(
        default=20.0,
        gt=0.0,
        description="How long a candidate waits for the next closed tick before it is dropped [s].",
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
        "brings a refit forward at once; while R̂ leaves more of the newest rows, no candidate is "
        "judged [1].",
    )
    follow_drift: bool = Field(
        default=True,
        description="Whether a refit is due at every look while R drifts quickly; else it waits "
        "for `every`.",
    )
    changes: ChangeSettings = Field(
        default=ChangeSettings(),
        description="Detection of a slow change of the response, which brings a refit forward.",
    )
    process: bool = Field(
        default=True,
        description="Whether the learner computes in a process of its own, so that it cannot "
        "disturb the tick.",
    )
    tolerance: float = Field(
        default=0.05,
        gt=0.0,
        description="Largest |readback − setpoint| of a row that the learner uses [A].",
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
    shadow: ShadowSettings = Field(
        default=ShadowSettings(), description="Trial of accepted candidates on live orbits."
    )
