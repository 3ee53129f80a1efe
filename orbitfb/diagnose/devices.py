"""Make layouts: from a ring, or from names and a model that came with a record."""

import re
from collections.abc import Sequence

from orbitfb.effects.layout import ChannelPlane, Devices, Layout
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring, split
from orbitfb.physics.response import response as nominal_response

DEFAULT_PERIOD = 0.1
"""From one orbit to the next when nobody says [s]."""

_CELL = re.compile(r"(?:^|[_:-])(C\d{1,3})(?:$|[_:-])")


def cell_of(name: str) -> str:
    """Tell the cell that a name follows the convention with (`PH1A_C30`); empty if it does not."""
    found = _CELL.search(name)
    return found.group(1) if found else ""


def devices(names: Sequence[str], planes: Sequence[ChannelPlane]) -> Devices:
    """Describe the devices behind columns; their cells come from their names.

    Args:
        names: k names.
        planes: k planes.
    """
    return Devices(tuple(names), tuple(planes), tuple(cell_of(name) for name in names))


def ring_layout(
    ring: Ring,
    planes: Planes = "x",
    response: Matrix | None = None,
    period: float = DEFAULT_PERIOD,
) -> Layout:
    """Describe all BPMs and correctors of a ring.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        response: Model, shape (n, m) [m/A]; that of the ring's optics when None.
        period: From one orbit to the next [s].
    """
    each = split(planes)
    bpms, correctors = ring.names("BPM"), ring.names("COR")
    return Layout(
        bpms=devices(bpms * len(each), [plane for plane in each for _ in bpms]),
        correctors=devices(correctors * len(each), [plane for plane in each for _ in correctors]),
        response=nominal_response(ring, planes) if response is None else response,
        period=period,
        ring=ring,
    )
