"""How the loop is paced, closed and held."""

from pydantic import Field

from orbitfb.core.settings import Settings

MOST_AVERAGED = 1000
"""Most orbits that are averaged: at 10 Hz a correction in 100 s."""


class LoopSettings(Settings):
    """Configuration of the loop."""

    rate_hz: float = Field(default=10.0, gt=0, le=1e4, description="Ticks per second [Hz].")
    ramp: float = Field(
        default=1.0,
        ge=0,
        description="Time over which the gain rises from 0 to 1 after closing [s].",
    )
    hold_after: float = Field(
        default=1.9, gt=1, le=1e5, description="Periods without a fresh orbit before HELD."
    )
    trip_after: float | None = Field(
        default=600.0,
        gt=0,
        description="Time in HELD after which the loop trips [s]; false = never.",
    )
    policy_deadline: float = Field(
        default=1.0,
        gt=0,
        description="Periods that a policy may take to learn from an orbit and decide on the next; "
        "else the baseline decides.",
    )
    proving: int = Field(
        default=3, ge=1, description="Good orbits in a row before a held loop closes again."
    )
    reclose: bool = Field(
        default=True, description="Whether a held loop closes by itself, or waits for the command."
    )
    return_after_trip: bool = Field(
        default=False,
        description="Whether to go back to the last good setpoints after a trip for the orbit, "
        "in limited steps that stop at once if anything is wrong.",
    )
    return_step: float = Field(
        default=0.5,
        gt=0,
        description="Largest change of a setpoint in one step of that return [A].",
    )
    return_good: float = Field(
        default=20e-6,
        gt=0,
        description="Rms orbit error up to which setpoints count as good [m].",
    )
    reference_speed: float = Field(
        default=100e-6,
        gt=0,
        le=1.0,
        description="Fastest movement of the reference at any BPM while the loop is closed [m/s].",
    )

    average: int = Field(
        default=1,
        ge=1,
        le=MOST_AVERAGED,
        description="Orbits that are averaged for a correction: it corrects once in so many ticks.",
    )
    dead_band: float = Field(
        default=0.0,
        ge=0,
        description=(
            "Rms orbit error of a plane below which the plane is not corrected [m]; 0: none."
        ),
    )

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return 1.0 / self.rate_hz

    @property
    def patience(self) -> float:
        """Time without a fresh orbit before HELD [s]."""
        return self.hold_after * self.period
