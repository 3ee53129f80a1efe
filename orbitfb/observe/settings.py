"""Configuration of what people and their tools see."""

from typing import Literal

from pydantic import Field

from orbitfb.core.settings import Settings


class LogSettings(Settings):
    """The JSON log."""

    file: str = Field(
        default="orbitfb.log.jsonl",
        description="Log file, one JSON object per line; relative to the data directory of the "
        "service; empty writes no file",
    )
    stderr: bool = Field(default=False, description="Write the same lines to stderr")
    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Least severe events that are written"
    )
    largest: int = Field(
        default=10_000_000,
        ge=10_000,
        le=10_000_000_000,
        description="Size at which the file is put aside and a new one begun [bytes]",
    )
    kept: int = Field(default=5, ge=1, le=1000, description="Files put aside that are kept")
    quiet_time: float = Field(
        default=10.0,
        ge=0.0,
        le=3600.0,
        description="Least time between two lines about missed orbits, shortened changes or "
        "masked BPMs [s]; what happens in between is counted",
    )


class TerminalSettings(Settings):
    """The status in the terminal."""

    mode: Literal["auto", "live", "plain", "off"] = Field(
        default="auto",
        description="`live` draws a panel, `plain` writes lines, `auto` is live on a terminal and "
        "plain elsewhere, `off` shows nothing",
    )
    rate: float = Field(
        default=4.0, ge=0.2, le=20.0, description="How often the panel is drawn [Hz]"
    )
    line_period: float = Field(
        default=1.0, ge=0.1, le=86_400.0, description="Time between two plain lines [s]"
    )


class ObserveSettings(Settings):
    """HTTP endpoints for Prometheus and for health checks, log, terminal."""

    enabled: bool = Field(
        default=True, description="Serve /metrics, /healthz and /readyz over HTTP"
    )
    host: str = Field(
        default="127.0.0.1",
        min_length=1,
        description="Address to listen on; anything but loopback shows the figures to the network",
    )
    port: int = Field(default=9180, ge=0, le=65535, description="TCP port; 0 takes any free one")
    names: tuple[str, ...] = Field(
        default=(),
        description="Host names by which it may be asked, in addition to localhost, this "
        "computer's own name and plain addresses; a name that is not here is refused",
    )
    stale_after: float = Field(
        default=5.0,
        gt=0.0,
        le=3600.0,
        description="Time without a tick after which the loop counts as not alive [s]; longer "
        "than `loop.hold_after` periods, and so by itself if left out",
    )
    logs: LogSettings = Field(default=LogSettings(), description="The JSON log")
    terminal: TerminalSettings = Field(
        default=TerminalSettings(), description="The status in the terminal"
    )
