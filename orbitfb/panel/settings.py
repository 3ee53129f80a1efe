"""Configuration of the panel."""

from pathlib import Path

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.epics.settings import LOWEST_PORT

PORT = 15074


class PanelSettings(Settings):
    """The loop's own PVs, served beside it by a process of their own."""

    enabled: bool = Field(default=False, description="Serve them.")
    prefix: str = Field(
        default="SR:FB{Orbit}",
        max_length=30,
        pattern=r"^[!-~]*$",
        description="What every PV of the panel begins with; no two panels may share it.",
    )
    interface: str = Field(
        default="127.0.0.1",
        min_length=1,
        description="Address to listen on; anything but loopback opens it to the network.",
    )
    port: int = Field(
        default=PORT,
        ge=0,
        lt=65536,
        description=f"Channel Access port; 0: any free one. libca finds none below {LOWEST_PORT}.",
    )
    period: float = Field(
        default=0.5, ge=0.05, le=60.0, description="Time between two updates of the PVs [s]."
    )
    rules: Path | None = Field(
        default=None,
        description="File of access rules (TOML): who may write what from where; none: whoever is "
        "on the service's own host may write everything, everybody else may read.",
    )
    reference_limit: float = Field(
        default=1e-3,
        gt=0,
        le=0.1,
        description="Largest reference that is accepted, absolute, at any BPM [m].",
    )
    bump_limit: float = Field(
        default=0.5e-3,
        gt=0,
        le=0.1,
        description="Largest position that is accepted of a closed bump, at its place [m].",
    )
    bump_angle_limit: float = Field(
        default=0.1e-3,
        gt=0,
        le=0.1,
        description="Largest angle that is accepted of a closed bump, at its place [rad].",
    )
    dead_band_limit: float = Field(
        default=20e-6,
        gt=0,
        le=1e-3,
        description="Largest dead band that is accepted, rms orbit error of a plane [m].",
    )
    dither_limit: float = Field(
        default=20e-6,
        gt=0,
        le=1e-3,
        description="Largest orbit motion by the dither that is accepted [m].",
    )
