"""The lease of the machine that the service holds while it runs."""

import time
from collections.abc import Callable
from contextlib import ExitStack

import structlog

from orbitfb.config import AppConfig
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import OwnershipError
from orbitfb.epics.lease import Lease, LeaseThread
from orbitfb.epics.lease_pvs import LeasePvs
from orbitfb.epics.settings import EpicsSettings

_log = structlog.stdlib.get_logger("orbitfb.service")


def take_lease(
    config: AppConfig,
    epics: EpicsSettings,
    lost: Callable[[str], None],
    stack: ExitStack,
) -> Lease | None:
    """Be the only controller of the machine among all that know its lease.

    Args:
        config: Has the PV and the time.
        epics: Where the machine is.
        lost: Told who took the lease away.
        stack: Gives it back.

    Returns:
        The lease; None where there is none to hold.

    Raises:
        OwnershipError: Somebody else holds it and lives, or a required one is not there.
        MachineError: It cannot be read or written.
    """
    settings = config.lease
    names = settings.pvs(config.ring.planes)
    if not names:
        return None
    board = LeasePvs(names, epics, settings.wait)
    stack.callback(board.close)
    if missing := board.missing:
        told = f"the lease {', '.join(missing)} is not there, or may not be written"
        if settings.required:
            raise OwnershipError(
                f"{told}; let the machine's IOC serve it, or name another with lease.pv"
            )
        _log.warning("no_lease", problem=f"{told}: another controller would not be noticed")
        return None
    lease = Lease(board, settings, SystemClock(), _wait, lost)
    before = lease.take()
    if before:
        _log.warning("stale_lease_taken_over", before=before, owner=lease.owner)
    else:
        _log.info("lease_taken", owner=lease.owner)
    stack.callback(LeaseThread(lease).stop)
    return lease


def _wait(seconds: float) -> bool:
    time.sleep(seconds)
    return False
