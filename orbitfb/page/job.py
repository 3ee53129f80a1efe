"""Everything that the page's process needs to know, in one line of JSON."""

from pathlib import Path
from typing import Self

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels
from orbitfb.page.settings import WebSettings
from orbitfb.physics.places import Planes, Ring


class PageLayout(Settings):
    """What does not change while a service runs; vectors are x first, then y."""

    planes: Planes = Field(description="Planes under feedback.")
    bpms: tuple[str, ...] = Field(description="Names of the BPMs.")
    bpm_counts: tuple[int, ...] = Field(
        default=(), description="BPMs of each plane; empty: as many in each."
    )
    bpm_s: tuple[float, ...] = Field(description="Their places [m].")
    correctors: tuple[str, ...] = Field(description="Names of the correctors.")
    corrector_counts: tuple[int, ...] = Field(
        default=(), description="Correctors of each plane; empty: as many in each."
    )
    corrector_s: tuple[float, ...] = Field(description="Their places [m].")
    circumference: float = Field(gt=0, description="Of the ring [m].")
    limit: float = Field(gt=0, description="Limit of a setpoint, absolute [A].")
    period: float = Field(gt=0, description="Of the loop [s].")

    @classmethod
    def of(cls, ring: Ring, channels: Channels, limit: float, period: float) -> Self:
        """Take it from the ring under feedback.

        Args:
            ring: Says where things are.
            channels: Of the loop.
            limit: Of a setpoint, absolute [A].
            period: Of the loop [s].
        """
        at = dict(zip(ring.table.name, ring.table.s.tolist(), strict=True))
        return cls.model_validate(
            {
                "planes": channels.planes,
                "bpms": channels.bpms,
                "bpm_counts": channels.bpm_counts,
                "corrector_counts": channels.corrector_counts,
                "bpm_s": tuple(at[name] for name in channels.bpms),
                "correctors": channels.correctors,
                "corrector_s": tuple(at[name] for name in channels.correctors),
                "circumference": ring.parameters.circumference,
                "limit": limit,
                "period": period,
            }
        )


class PageJob(Settings):
    """A service to show."""

    data_directory: Path = Field(description="The service's data directory: its name.")
    web: WebSettings = Field(description="Where and to whom the page is served.")
    layout: PageLayout = Field(description="The ring under feedback.")
