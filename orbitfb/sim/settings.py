"""What can be configured at the soft IOC."""

from pathlib import Path

from pydantic import Field, field_validator

from orbitfb.core.settings import Settings

_LOWEST_PORT = 5001


class SimSettings(Settings):
    """The soft IOC that serves a simulated ring."""

    rate_hz: float = Field(
        default=10.0, gt=0, le=2000, description="How often the ring shows a new orbit [Hz]."
    )
    port: int = Field(
        default=15064,
        ge=0,
        le=65535,
        description="Channel Access port, TCP and UDP; 0 takes any free one. Production is 5064.",
    )
    pva_port: int = Field(
        default=15076,
        ge=0,
        le=65535,
        description="UDP port where searches over pvAccess come, if the places table names arrays "
        "`pva://…`; 0 takes any free one. Production is 5076.",
    )
    interface: str = Field(
        default="127.0.0.1", description="Address to listen on; the default is this computer alone."
    )
    lockstep: bool = Field(
        default=False,
        description=(
            "Advance the ring as soon as the setpoints that were written before the last tick "
            "have been written anew, and at the latest after the period: an accelerated clock."
        ),
    )
    plain: bool = Field(
        default=False,
        description="Serve by caproto's documented calls alone: the slow reference to compare to.",
    )
    corrector_limit: float = Field(
        default=18.0, gt=0, description="Drive limit of every setpoint, plus and minus [A]."
    )
    corrector_warning: float = Field(
        default=0.9, gt=0, le=1, description="Part of the drive limit at which a corrector warns."
    )
    orbit_warning: float = Field(
        default=1.0e-3,
        gt=0,
        description="Reading at which a BPM warns (MINOR), plus and minus [m].",
    )
    orbit_alarm: float = Field(
        default=3.0e-3,
        gt=0,
        description="Reading at which a BPM alarms (MAJOR), plus and minus [m].",
    )
    stored_current: float = Field(
        default=0.4, ge=0, description="Stored current that the DCCT shows [A]."
    )
    rf_frequency: float | None = Field(
        default=None,
        gt=0,
        description="RF frequency of the oscillator at the start [Hz]; the ring's if not set.",
    )
    rf_range: float = Field(
        default=1000.0,
        gt=0,
        description="Drive limit of the RF setpoint, plus and minus from the frequency at the "
        "start [Hz].",
    )
    kick_limit: float = Field(
        default=5.0e-3, gt=0, description="Largest random kick, rms at the BPMs [m]."
    )
    response: Path | None = Field(
        default=None,
        description="Measured response matrix that the simulated ring answers with, as `orbitfb "
        "measure-response` or `orbitfb import response` writes it; none: that of the optics. What "
        "was not measured stays as the optics say.",
    )
    send_buffer: int = Field(
        default=32768,
        ge=4096,
        description=(
            "Socket buffer for each client [bytes]; small, so that a slow client misses whole "
            "orbits instead of seeing old ones."
        ),
    )

    @field_validator("port")
    @classmethod
    def _reachable(cls, port: int) -> int:
        if 0 < port < _LOWEST_PORT:
            raise ValueError(
                f"clients that use libca take 5064 for any port below {_LOWEST_PORT}, so they "
                "would go to the machine; choose 0 or a higher one"
            )
        return port
