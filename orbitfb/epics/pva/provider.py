"""The client of pvAccess: p4p, loaded only where a PV is named `pva://…`."""

import importlib
from collections.abc import Iterable
from typing import Any

from orbitfb.core.errors import MachineError
from orbitfb.core.names import PVA, any_over_pva
from orbitfb.epics.settings import EpicsSettings

ADVICE = "install it with `pip install 'orbitfb[pva]'`, or name PVs of Channel Access"


def p4p(module: str) -> Any:
    """Import a part of p4p.

    Args:
        module: Its name within p4p.

    Raises:
        MachineError: The extra is not installed.
    """
    try:
        return importlib.import_module(f"p4p.{module}")
    except ImportError as cause:
        raise MachineError(f"PVs named {PVA}… need the extra `pva` ({cause}); {ADVICE}") from cause


def search_of(settings: EpicsSettings) -> dict[str, str]:
    """Say where PVs are searched for, in the words of EPICS.

    Args:
        settings: Of the machine.
    """
    return {
        "EPICS_PVA_ADDR_LIST": settings.pva_addresses,
        "EPICS_PVA_AUTO_ADDR_LIST": "YES" if settings.auto_address_list else "NO",
        "EPICS_PVA_NAME_SERVERS": settings.pva.name_servers,
        "EPICS_PVA_BROADCAST_PORT": str(settings.pva.port),
        "EPICS_PVA_CONN_TMO": str(settings.circuit_timeout),
    }


def pva_client(settings: EpicsSettings, names: Iterable[str]) -> Any:
    """Make a client with threads of its own if one of the PVs is over pvAccess; else None.

    Args:
        settings: Where to search.
        names: Of the PVs.

    Raises:
        MachineError: The extra is not installed, or the client cannot start.
    """
    if not any_over_pva(names):
        return None
    raw = p4p("client.raw")
    try:
        return raw.Context("pva", conf=search_of(settings), useenv=False, nt=False)
    except RuntimeError as cause:
        raise MachineError(
            f"the client of pvAccess cannot start: {cause}; see epics.pva"
        ) from cause
