"""How much is kept of a trip, and for how long."""

from pydantic import Field

from orbitfb.core.settings import Settings


class PostMortemSettings(Settings):
    """Configuration of the post-mortems."""

    enabled: bool = Field(default=True, description="Whether a trip is frozen to a file.")
    before: float = Field(
        default=60.0, gt=0, le=3600.0, description="Time kept before the trip [s]."
    )
    after: float = Field(default=5.0, ge=0, le=600.0, description="Time kept after the trip [s].")
    most_ticks: int = Field(
        default=10_000,
        ge=100,
        le=200_000,
        description="Ticks kept at most; at a high rate they cover less than the times above.",
    )
    kept_files: int = Field(
        default=50, ge=1, le=10_000, description="Newest post-mortems that are kept."
    )
    kept_megabytes: float = Field(
        default=1000.0,
        gt=0,
        description="Oldest post-mortems are removed beyond this size together [MB]; the newest "
        "stays.",
    )
