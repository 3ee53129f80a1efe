"""Everything that the panel's process needs to know, in one line of JSON."""

from pathlib import Path

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.panel.pv_table import Extent
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Planes


class PanelJob(Settings):
    """A service to show and to command."""

    data_directory: Path = Field(description="The service's data directory: its name.")
    panel: PanelSettings = Field(description="Where and how the PVs are served.")
    planes: Planes = Field(description="Planes under feedback.")
    bpms: int = Field(gt=0, description="Length of an orbit.")
    correctors: int = Field(gt=0, description="Length of a set of setpoints.")
    bpm_counts: tuple[int, ...] = Field(
        default=(), description="BPMs of each plane; empty: as many in each."
    )
    corrector_counts: tuple[int, ...] = Field(
        default=(), description="Correctors of each plane; empty: as many in each."
    )
    still: dict[str, tuple[float, ...] | tuple[str, ...]] = Field(
        default={}, description="Values that never change, by PV, in its units."
    )

    @property
    def extent(self) -> Extent:
        """What the table of PVs depends on."""
        return Extent(
            self.planes, self.bpms, self.correctors, self.bpm_counts, self.corrector_counts
        )
