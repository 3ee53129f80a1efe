"""Configuration of the diagnosis beside the loop."""

from pydantic import Field

from orbitfb.core.settings import Settings


class LiveSettings(Settings):
    """The service's watch over its own gap."""

    enabled: bool = Field(
        default=True,
        description="Whether the service watches its own gap, in a process of low priority.",
    )
    period: float = Field(
        default=60.0, ge=1.0, description="From one look to the next, at least [s]."
    )
    window: int = Field(
        default=600, ge=200, le=5000, description="Ticks that are looked at [ticks]."
    )
    screen: bool = Field(
        default=True,
        description="Whether the learner refuses rows of devices that the watch calls broken.",
    )


class DiagnoseSettings(Settings):
    """Configuration of the diagnosis."""

    live: LiveSettings = Field(default=LiveSettings(), description="Watch of the running loop.")
