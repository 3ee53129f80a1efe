"""Nobody runs on a machine by accident."""

from orbitfb.app.setup.startup import PRODUCTION_PORT, SIMULATED, servers_of
from orbitfb.core.errors import ConfigError
from orbitfb.epics.settings import EpicsSettings


def check_live(settings: EpicsSettings, ioc: str, start: str | None, live: bool) -> None:
    """Refuse the port of production unless it is meant; then the loop starts OPEN.

    Args:
        settings: Where the ring is.
        ioc: As on the command line.
        start: As on the command line.
        live: Whether `--live` was given.

    Raises:
        ConfigError: It is not meant, or the loop would close without a command.
    """
    ports = {server.rpartition(":")[2] for server in servers_of(settings)}
    if str(PRODUCTION_PORT) in ports and ioc != SIMULATED and not live:
        raise ConfigError(
            f"--ioc {ioc}: that is port {PRODUCTION_PORT}, on which machines are; give --live if "
            "you mean to run on a machine, or name the port of a simulated ring (orbitfb ioc has "
            "15064)"
        )
    if live and start is not None and start.lower() == "closed":
        raise ConfigError(
            "--live starts OPEN, whatever --start says; look at the orbit, then close the loop "
            "with `orbitfb command close`"
        )
