"""Configuration of the RF frequency as an actuator."""

from pydantic import Field

from orbitfb.core.names import RF_PV, RF_READBACK_PV, RF_TOLERANCE
from orbitfb.core.settings import Settings


class RfSettings(Settings):
    """The RF frequency as an actuator: it follows the energy that the correctors would make up."""

    enabled: bool | None = Field(
        default=None,
        description="Whether the frequency follows; by default only with `--ioc sim` and plane x.",
    )
    setpoint_pv: str = Field(
        default=RF_PV, min_length=1, description="PV of the setpoint of the frequency [Hz]."
    )
    readback_pv: str = Field(
        default=RF_READBACK_PV,
        description="PV of its readback [Hz]; empty: there is none, and the setpoint is used.",
    )
    tolerance: float = Field(
        default=RF_TOLERANCE,
        gt=0,
        description="Largest difference of a frequency that follows [Hz].",
    )
    settle: float = Field(
        default=2.0, gt=0, description="Time in which a step must have arrived [s]."
    )
    dead_band: float = Field(
        default=2e-6,
        gt=0,
        le=1e-3,
        description="Relative energy that the correctors may make before a step takes it over [1].",
    )
    largest_step: float = Field(default=1.0, gt=0, le=5.0, description="Largest step [Hz].")
    interval: float = Field(default=1.0, ge=0.1, description="Shortest time between two steps [s].")
    range: float = Field(
        default=500.0,
        gt=0,
        description="Farthest from the frequency at which the loop was closed [Hz].",
    )
