"""Configuration of the operator page."""

from pydantic import Field

from orbitfb.core.settings import Settings

PORT = 9181


class WebSettings(Settings):
    """The operator page, served beside the loop by a process of its own; read-only."""

    enabled: bool = Field(
        default=True,
        description="Serve it; the loop runs without it where the extra `web` is not installed or "
        "the port is taken.",
    )
    host: str = Field(
        default="127.0.0.1",
        min_length=1,
        description="Address to listen on; anything but loopback shows the loop to the network.",
    )
    port: int = Field(default=PORT, ge=0, le=65535, description="TCP port; 0 takes any free one.")
    names: tuple[str, ...] = Field(
        default=(),
        description="Host names by which browsers may ask for it, in addition to localhost, this "
        "computer's own name and plain addresses; a name that is not here is refused.",
    )
    viewers: int = Field(
        default=20,
        ge=1,
        le=1000,
        description="Pages that are shown at a time; one more is refused.",
    )
