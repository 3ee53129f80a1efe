"""Configuration of the diagnosis beside the loop."""

from pydantic import Field

from orbitfb.core.settings import Settings


class LiveSettings(Settings):
    """The service's watch over its own gap."""

    enabled: bool = Field(
        default=True,
        description=(
            "Whether the service looks for a gap while it runs, in a process of low priority."
        ),
    )
    period: float = Field(
        default=60.0, ge=1.0, description="Shortest time from one look to the next [s]."
    )
    window: int = Field(
        default=600, ge=200, le=5000, description="Newest ticks in each look [ticks]."
    )
    screen: bool = Field(
        default=True,
        description="Whether the learner leaves out rows of devices that a look finds broken.",
    )


class DiagnoseSettings(Settings):
    """Configuration of the diagnosis."""

    live: LiveSettings = Field(
        default=LiveSettings(), description="Looks for a gap while the loop runs."
    )
