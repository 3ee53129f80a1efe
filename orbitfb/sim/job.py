"""Everything the soft IOC's process needs to know, in one line of JSON."""

from pathlib import Path

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.sim.layout import check_served
from orbitfb.sim.measured import MeasuredRing
from orbitfb.sim.settings import SimSettings

PORT_TAKEN = 3
"""Exit status of a soft IOC whose port somebody else has."""


class SimJob(Settings):
    """A ring to simulate and how to serve it."""

    places: Path | None = Field(
        default=None, description="Table of places (CSV); the default ring's when not given."
    )
    parameters: Path | None = Field(
        default=None,
        description="Parameters of the ring (JSON); the default ring's when not given.",
    )
    planes: Planes = Field(default="x", description="Planes of the orbit: x, y or xy.")
    seed: int = Field(default=0, ge=0, description="Seed of every random number of the ring.")
    plant: PlantSettings = Field(default=PlantSettings(), description="What the ring suffers from.")
    effects: tuple[EffectSettings, ...] = Field(
        default=(), description="Effects that the ring has besides."
    )
    period: float | None = Field(
        default=None,
        gt=0,
        description="From one orbit to the next, by which effects count time [s]; none: that of "
        "`sim.rate_hz`, which in lockstep is a limit only.",
    )
    sim: SimSettings = Field(default=SimSettings(), description="Where and how it is served.")

    def build(self) -> tuple[Plant, SimSettings]:
        """Make the ring, and the settings with what only the ring knows filled in.

        Raises:
            RingError: The table, the parameters or the measured response are wrong.
            ConfigError: An effect is to be where nothing is.
        """
        ring = Ring.load(self.places, self.parameters)
        settings = self.sim
        check_served(ring.channels(self.planes), settings)
        if settings.rf_frequency is None:
            settings = settings.model_copy(update={"rf_frequency": ring.rf_frequency})
        period = self.period or 1.0 / settings.rate_hz
        file = settings.response
        first = () if file is None else (MeasuredRing(file, ring, self.planes),)
        plant = plant_with(ring, self.planes, self.plant, self.seed, self.effects, period, first)
        return plant, settings
