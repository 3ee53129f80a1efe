"""Nobody runs on a machine by accident."""

from collections.abc import Iterable

from orbitfb.app.setup.startup import PRODUCTION_PORT, SIMULATED, servers_of
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.names import any_over_pva
from orbitfb.epics.settings import PVA_SEARCH_PORT, EpicsSettings


def check_live(
    settings: EpicsSettings, ioc: str, start: str | None, live: bool, pvs: Iterable[str] = ()
) -> None:
    """Refuse the ports of production unless they are meant; then the loop starts OPEN.

    Args:
        settings: Where the ring is.
        ioc: As on the command line.
        start: As on the command line.
        live: Whether `--live` was given.
        pvs: Those of the ring: the port of pvAccess counts if one of them is over it.

    Raises:
        ConfigError: It is not meant, or the loop would close without a command.
    """
    ports = {server.rpartition(":")[2] for server in servers_of(settings)}
    over_pva = settings.pva.port == PVA_SEARCH_PORT and any_over_pva(pvs)
    if over_pva and ioc != SIMULATED and not live:
        raise ConfigError(
            f"--ioc {ioc}: PVs over pvAccess are searched for at port {PVA_SEARCH_PORT}, on which "
            "machines are; give --live if you mean to run on a machine, or let epics.pva.port name "
            "the port of a simulated ring (orbitfb ioc has 15076)"
        )
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


def pvs_of(config: AppConfig) -> tuple[str, ...]:
    """Give every PV that the configuration names.

    Args:
        config: With its ring.

    Raises:
        RingError: The places table is wrong.
    """
    slow = [its.pv for its in config.epics.auxiliary.values()]
    references = config.fast_feedback.reference_pvs.values()
    ring = config.ring.load().channels(config.ring.planes).pvs
    return (*ring, *slow, config.rf.setpoint_pv, *references)
