"""Configuration of the recursive estimate of R and of the cautious gain made from it."""

from pydantic import Field

from orbitfb.core.settings import Settings

MOST_GROUPS = 20


class RecursiveSettings(Settings):
    """What is known beforehand. [R] is the unit of R: m/A, or m/rad where changes are kicks."""

    reading_noise: float = Field(default=0.2e-6, gt=0.0, description="BPM noise, rms [m].")
    ground: float = Field(
        default=0.0,
        ge=0.0,
        description="Motion of the orbit per tick, as kicks along the ring make it, rms [m].",
    )
    white: float = Field(
        default=0.0, ge=0.0, description="White part of the motion of the orbit per tick, rms [m]."
    )
    minimum_gain: float = Field(
        default=0.02, gt=0.0, lt=1.0, description="Smallest gain of the orbit's filter [1]."
    )
    prior_entry: float = Field(
        default=0.01, ge=0.0, description="Error of an element of the first R̂, rms [R]."
    )
    prior_relative: float = Field(
        default=0.0,
        ge=0.0,
        description="Errors of the gains of BPMs and correctors in the first R̂, rms [1].",
    )
    rf_error: float = Field(
        default=0.2,
        gt=0.0,
        description="Error of the RF column as it is told, relative to its rms, rms [1].",
    )
    drift_entry: float = Field(
        default=1e-3, ge=0.0, description="Drift of an element of R in √tick, rms [R]."
    )
    drift_relative: float = Field(
        default=0.0,
        ge=0.0,
        description="Drift of the gains of BPMs and correctors in √tick, rms [1].",
    )
    drift_every: int = Field(
        default=30,
        ge=1,
        description="Ticks after which drift is added to the doubt, and R is learnt at the latest "
        "[ticks].",
    )
    creep: float = Field(
        default=0.0,
        ge=0.0,
        description="Creep of the orbit that a drift of R makes of setpoints that stay, rms over "
        "the modes, each in proportion to its singular value [m/tick]; 0: no such coefficient.",
    )
    creep_white: float = Field(
        default=1e-9, ge=0.0, description="The part of the creep that all modes have, rms [m/tick]."
    )
    creep_held: float | None = Field(
        default=None,
        gt=0.0,
        description="Norm of the currents for which this creep is told, those of before the loop "
        "closed; it grows and turns with what is held since [A, or rad where changes are kicks]. "
        "Unset: it is the same whatever is held.",
    )
    rf_creep: float = Field(
        default=0.0,
        ge=0.0,
        description="The part of the creep that an energy which drifts makes, where the RF column "
        "is tracked, as a drift of the frequency would [Hz/tick].",
    )
    creep_memory: float = Field(
        default=10_000.0, gt=0.0, description="Ticks in which the creep is renewed [ticks]."
    )
    groups: int = Field(
        default=4,
        ge=1,
        le=MOST_GROUPS,
        description="Groups of modes with a covariance of their own [1].",
    )
    kick_chi2: float = Field(
        default=25.0,
        gt=1.0,
        description="Mean squared normalised innovation of a reading taken for a kick [1].",
    )
    noise_model: bool = Field(
        default=True,
        description="Whether the orbit is filtered; without, R̂ is the naive estimate (for "
        "comparison only).",
    )


class CautionSettings(Settings):
    """How the gain is made from R̂ and its covariance, and when it is made anew."""

    caution: float = Field(
        default=0.7,
        ge=0.0,
        description="Share of the doubt about R that counts; below 1 because a doubt that the "
        "next reading removes costs only once [1]. 0: no caution, for comparison only.",
    )
    regularisation: float = Field(
        default=0.0, ge=0.0, description="Tikhonov λ beside the caution, or of small currents [R]."
    )
    price: float = Field(
        default=0.0,
        ge=0.0,
        description="ν, the price of a current that is held: λ of its corrector, for every ampere "
        "since the loop closed [R/A].",
    )
    longest: float = Field(
        default=10.0,
        ge=1.0,
        description="Ticks beyond which the time that a mode takes to fall is not weighed [ticks].",
    )
    far: float = Field(
        default=5.0,
        gt=0.0,
        description="Orbit from which a mistake about strong modes is weighed too, in units of "
        "what the noise makes expect [1].",
    )
    period: int = Field(default=50, ge=1, description="Ticks after which the gain is renewed.")
    events: bool = Field(
        default=True, description="Whether it is renewed at once when the readings call for it."
    )
    chi2: float = Field(
        default=1.6, gt=1.0, description="Mean squared normalised innovation that calls for it [1]."
    )
    doubt: float = Field(
        default=0.5,
        gt=0.0,
        description="Variance that not knowing R adds to the innovation, over what it has "
        "without, that calls for it [1].",
    )
