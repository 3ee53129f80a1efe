"""Configuration of the identification."""

from pydantic import Field

from orbitfb.core.settings import Settings


class IdentifySettings(Settings):
    """Configuration of the identification."""

    reading_noise: float = Field(
        default=0.2e-6, gt=0.0, description="BPM noise to believe before there are data, rms [m]."
    )
    ground: float = Field(
        default=0.04e-6,
        gt=0.0,
        description="Orbit motion per tick to believe before there are data, rms [m].",
    )
    noise_memory: float = Field(
        default=3000.0,
        gt=0.0,
        description="Rows after which an innovation counts 1/e for the noise [1].",
    )
    prior_entry: float = Field(
        default=1e-6, ge=0.0, description="Error of an element of the first R̂, rms [m/A]."
    )
    prior_relative: float = Field(
        default=0.02, ge=0.0, description="Error of the first R̂ relative to its size, rms [1]."
    )
    drift_entry: float = Field(
        default=0.08e-6, ge=0.0, description="Drift of an element of R in √tick, rms [m/A]."
    )
    drift_relative: float = Field(
        default=1e-3, ge=0.0, description="Drift of R relative to its size in √tick, rms [1]."
    )
    rf_error: float = Field(
        default=0.2,
        gt=0.0,
        description="Error of the RF column as the dispersion of the places table tells it: of its "
        "size, and place by place relative to its rms, rms [1].",
    )
    creep: float = Field(
        default=5e-9,
        gt=0.0,
        description="Creep of the orbit that a drift of R makes, rms per mode [m/tick].",
    )
    creep_memory: float = Field(
        default=2000.0, gt=0.0, description="Ticks in which the creep is renewed [ticks]."
    )
    memory: float = Field(
        default=2000.0,
        gt=0.0,
        description="Rows after which a row counts 1/e while R drifts; R begins to drift, or comes "
        "to rest, about once in so many [1].",
    )
    block: int = Field(
        default=50,
        ge=1,
        le=511,
        description="Rows that are predicted before R̂ is computed again, while R drifts quickly "
        "or rows are few; else half as many as came before [1].",
    )
    kick_chi2: float = Field(
        default=25.0,
        gt=1.0,
        description="Mean squared normalised innovation of a row that is taken for a kick [1].",
    )
    change_entry: float = Field(
        default=0.3e-6,
        gt=0.0,
        description="Change of an element of R that the change detector expects, rms [m/A].",
    )
    change_memory: float = Field(
        default=3000.0,
        gt=0.0,
        description="Rows after which a row counts 1/e for the change that is expected [1].",
    )


class ChangeSettings(Settings):
    """Configuration of the change detector."""

    false_alarms_per_day: float = Field(
        default=1.0,
        gt=0.0,
        le=1000.0,
        description="Alarms per day of ticks while R is as it was, at most [1/day].",
    )
    allowance: float = Field(
        default=0.005,
        ge=0.0,
        description="Evidence that a slightly wrong noise model may feign [nats per row].",
    )
    largest_share: float = Field(
        default=0.25,
        gt=0.0,
        le=1.0,
        description="What one block can count for, as a share of the threshold [1].",
    )
    reference_rows: float = Field(
        default=1000.0,
        gt=0.0,
        description="Rows after which an innovation counts 1/e for the reference of the noise [1].",
    )
    minimum_sensitivity: float = Field(
        default=20.0,
        ge=0.0,
        description="What the rows since the last swap must be worth before there is an alarm "
        "[nats].",
    )
