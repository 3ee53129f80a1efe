"""What can be asked of a running service: every command, and what goes with it.

Both ends look here, the service and `orbitfb command`, which starts quickly: it imports no more.
"""

from collections.abc import Mapping
from typing import Any

from orbitfb.core.errors import ControlError
from orbitfb.core.near_names import did_you_mean

SILENT = frozenset({"status", "panel", "page"})
"""Commands that change nothing and are not logged."""
ARGUMENTS: Mapping[str, tuple[str, ...]] = {
    "status": (),
    **dict.fromkeys(("open", "shadow", "close", "reset", "postmortem"), ()),
    "gain": ("plane", "value"),
    "reference": ("values",),
    "bump": ("place", "plane", "position", "angle"),
    "reference-save": ("name",),
    "reference-load": ("name",),
    "enable-bpms": ("enabled",),
    "enable-correctors": ("enabled",),
    "dither": ("orbit_cost",),
    "average": ("orbits",),
    "dead-band": ("plane", "value"),
    "rf": ("follow",),
    "try": ("plane", "singular_values", "regularisation", "weights"),
    "apply": (),
    "correct": ("law", "once"),
    "correct-apply": (),
    "undo": (),
    "measure": ("action", "fresh", "restore", "at_once"),
    "refit": ("activate",),
    "activate": ("policy", "force"),
}
"""What goes with every command that people give."""
_INSIDE = frozenset({"panel", "page", "refused"})
"""Requests of our own programs."""
_WITH_ALL = frozenset({"command", "origin", "peer"})


def check_request(request: Mapping[str, Any]) -> None:
    """Refuse what nobody knows: a key that is mistyped must not go unnoticed.

    Args:
        request: The command and what goes with it.

    Raises:
        ControlError: There is no such command, or it does not take all that came with it.
    """
    name = str(request.get("command"))
    if name in _INSIDE:
        return
    if name not in ARGUMENTS:
        hint = did_you_mean(name, ARGUMENTS, most=1)
        raise ControlError(f"no command {name!r}{hint}; there are {', '.join(ARGUMENTS)}")
    known = ARGUMENTS[name]
    if unknown := sorted({str(key) for key in request} - _WITH_ALL - set(known)):
        takes = f"takes {', '.join(known)} only" if known else "takes nothing with it"
        told = ", ".join(key + did_you_mean(key, known, most=1) for key in unknown)
        raise ControlError(f"{name} {takes}: {told} is unknown")
