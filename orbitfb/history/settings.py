"""Configuration of the archive."""

from pydantic import Field

from orbitfb.core.settings import Settings


class ArchiveSettings(Settings):
    """Configuration of the archive."""

    flush_interval: float = Field(
        default=0.5, gt=0.0, le=1.0, description="Longest time that a tick waits for the disk [s]."
    )
    segment_minutes: float = Field(
        default=10.0, gt=0.0, description="A new segment is begun after this time [min]."
    )
    segment_megabytes: float = Field(
        default=64.0, ge=1.0, le=1024.0, description="A new segment is begun at this size [MB]."
    )
    keep_gigabytes: float | None = Field(
        default=None,
        gt=0.0,
        description="Oldest segments are removed beyond this size [GB]; unset: never.",
    )
    compress: bool = Field(
        default=True, description="Whether full segments are rewritten compressed."
    )
    queue: int = Field(
        default=2000,
        ge=10,
        description="Ticks that may wait for the disk; more are dropped and counted.",
    )
    retry_interval: float = Field(
        default=5.0, gt=0.0, description="Time between attempts while the disk refuses [s]."
    )
