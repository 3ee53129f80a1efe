"""The lease of the machine that the service holds while it runs."""

import threading
from collections.abc import Callable
from contextlib import ExitStack

import structlog

from orbitfb.config.tree import AppConfig
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import OwnershipError
from orbitfb.epics.lease.late import LateLease
from orbitfb.epics.lease.lease import Lease, LeaseThread
from orbitfb.epics.lease.pvs import LeasePvs
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
        The lease, or one that is looked for as long as the machine has none; None where none is
        wanted.

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
        _log.warning("no_lease", problem=f"{told}: another controller is noticed by its puts alone")
    stop, clock = threading.Event(), SystemClock()
    if missing:
        lease = LateLease(
            board, settings, clock, stop.wait, lost, lambda: board.missing, _say_taken
        )
    else:
        lease = Lease(board, settings, clock, stop.wait, lost)
        _say_taken(lease.take())
    stack.callback(LeaseThread(lease, stop).stop)
    return lease


def _say_taken(before: str) -> None:
    if before:
        _log.warning("stale_lease_taken_over", before=before)
    else:
        _log.info("lease_taken")
