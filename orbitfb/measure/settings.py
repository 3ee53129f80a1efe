"""What can be configured at the measurement of the response matrix."""

from pydantic import Field

from orbitfb.core.settings import Settings


class MeasureSettings(Settings):
    """How `orbitfb measure-response` measures."""

    amplitude: float | None = Field(
        default=None,
        gt=0,
        description="Largest step of every corrector, of either sign [A]; none: by orbit_rms.",
    )
    orbit_rms: float = Field(
        default=50e-6,
        gt=0,
        description="Orbit that the largest step makes by the optics, or all correctors of a "
        "group together, rms [m].",
    )
    sizes: int = Field(
        default=2, ge=2, le=10, description="Sizes of step, evenly spaced, each with both signs."
    )
    repeats: int = Field(default=1, ge=1, le=100, description="Times that all steps are done.")
    orbits: int = Field(default=4, ge=2, le=1000, description="Orbits averaged at every step.")
    settle: int = Field(
        default=2, ge=1, le=1000, description="Orbits that are left out after every step."
    )
    settle_most: int = Field(
        default=20,
        ge=1,
        le=10_000,
        description="Orbits that a step may wait for the readback to come to its setpoint.",
    )
    at_once: int = Field(
        default=1,
        ge=0,
        description="Correctors that move at once, each at a frequency of its own; 1: one by one, "
        "by steps; 0: all of them.",
    )
    lowest: float = Field(
        default=0.04, gt=0, lt=0.5, description="Lowest frequency at once [1/tick]."
    )
    highest: float = Field(
        default=0.4, gt=0, lt=0.5, description="Highest frequency at once [1/tick]."
    )
    ticks: int = Field(
        default=300, ge=50, le=100_000, description="Least length of a pass at once [ticks]."
    )
    check: int = Field(
        default=3, ge=1, description="Correctors of those at once that are checked by steps."
    )
    agreement: float = Field(
        default=0.03,
        gt=0,
        lt=1,
        description="Largest difference of a checked column from that by steps, relative [1].",
    )
    excursion_rms: float = Field(
        default=300e-6,
        gt=0,
        description=(
            "Rms difference from the orbit at the start beyond which the measurement stops [m]."
        ),
    )
    excursion_max: float = Field(
        default=1e-3, gt=0, description="The same limit at a single BPM, of either sign [m]."
    )
    rejected_most: int = Field(
        default=20, ge=1, description="Orbits in a row that may be missing or unusable."
    )
    watch: int = Field(
        default=10,
        ge=2,
        le=1000,
        description="Orbits before the start for which nobody may move a setpoint.",
    )
    same_setpoint: float = Field(
        default=1e-4,
        gt=0,
        description="Difference up to which a setpoint read back is the one that was sent [A].",
    )
    linearity: float = Field(
        default=0.02,
        gt=0,
        lt=1,
        description="Part of a column that may not be linear, relative [1].",
    )
    noise: float = Field(
        default=0.05, gt=0, lt=1, description="Largest uncertainty of a column, relative [1]."
    )
    weakest: float = Field(
        default=0.1,
        gt=0,
        lt=1,
        description="Part of the response by the optics below which a corrector or BPM counts as "
        "dead [1].",
    )
    following: float = Field(
        default=0.05,
        gt=0,
        lt=1,
        description="How far the readback may change by less or more than its setpoint, "
        "relative [1].",
    )
    lag: float = Field(
        default=0.1,
        gt=0,
        lt=1.5,
        description="Largest phase at once of a corrector against all [rad].",
    )
    resume_within: float = Field(
        default=86_400.0,
        gt=0,
        description="Age of the first column up to which a measurement is resumed [s].",
    )
    restore_timeout: float = Field(
        default=30.0, gt=0, description="How long to try to put the setpoints back [s]."
    )
