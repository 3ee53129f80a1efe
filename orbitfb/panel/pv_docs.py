"""The PVs of the panel as a table of the reference pages."""

from orbitfb.panel.pv import VECTORS, Kind, PanelPv
from orbitfb.panel.pv_table import Extent, panel_pvs
from orbitfb.panel.settings import PanelSettings

_WORDS = {
    Kind.DOUBLE: "number",
    Kind.INTEGER: "integer",
    Kind.CHOICE: "choice",
    Kind.TEXT: "text (characters)",
    Kind.DOUBLES: "numbers",
    Kind.SWITCHES: "integers",
    Kind.NAMES: "texts",
}


def panel_table_markdown(settings: PanelSettings, extent: Extent) -> str:
    """Write all PVs of a panel as a table.

    Args:
        settings: Has the limits.
        extent: Of the ring.
    """
    rows = [
        "| PV | holds | unit | clients | writes allowed | meaning |",
        "|---|---|---|---|---|---|",
    ]
    rows += [_row(pv) for pv in panel_pvs(settings, extent)]
    return "\n".join(rows) + "\n"


def _row(pv: PanelPv) -> str:
    vector = pv.kind in VECTORS
    cells = (
        f"`{pv.name}`",
        f"{pv.length} {_WORDS[pv.kind]}" if vector else _WORDS[pv.kind],
        pv.units,
        "read, write" if pv.writable else "read",
        _allowed(pv),
        pv.meaning,
    )
    return "| " + " | ".join(cells) + " |"


def _allowed(pv: PanelPv) -> str:
    if not pv.writable:
        return "never"
    match pv.kind:
        case Kind.CHOICE:
            return ", ".join(f"`{state}`" for state in pv.states)
        case Kind.TEXT:
            return "a name"
        case _:
            return f"{pv.limits[0]:g} to {pv.limits[1]:g}"
