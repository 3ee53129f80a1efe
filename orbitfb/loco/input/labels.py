"""Names under which a measured response may know the devices of a table."""

from collections.abc import Mapping, Sequence

from orbitfb.core.errors import ExchangeError
from orbitfb.core.near_names import did_you_mean
from orbitfb.loco.measured import PLANES, Measured
from orbitfb.physics.places import Kind, Plane, Ring

Place = tuple[Plane | None, int]
"""Plane and place of a name; the plane is None where the name may be of both."""

_KINDS: tuple[Kind, Kind] = ("BPM", "COR")


def labels(ring: Ring, kind: Kind) -> Mapping[str, Place]:
    """Give the places of names, of NAME:x and NAME:y, and of PVs.

    A device of one plane has that plane under its plain name, too.
    """
    found: dict[str, Place] = {}
    own: dict[Plane, set[int]] = {plane: set(ring.places(kind, plane).tolist()) for plane in PLANES}
    for place in ring.places(kind).tolist():
        name = ring.table.name[place]
        there: list[Plane] = [plane for plane in PLANES if place in own[plane]]
        found[name] = (there[0] if len(there) == 1 else None, place)
        for plane in there:
            found[f"{name}:{plane}"] = (plane, place)
            for pvs in (ring.table.readback, ring.table.pv):
                pv = pvs[PLANES.index(plane)][place]
                if pv:
                    found[pv] = (plane, place)
    return found


def masked(measured: Measured, names: Sequence[str], ring: Ring) -> Measured:
    """Leave out the devices that the caller names.

    Args:
        measured: The measurement.
        names: NAME, in both planes, NAME:x, or a PV.
        ring: The ring.

    Raises:
        ExchangeError: There is no such device.
    """
    known = [labels(ring, kind) for kind in _KINDS]
    for name in names:
        its = next((own[name] for own in known if name in own), None)
        if its is None:
            hint = did_you_mean(name, [*known[0], *known[1]], most=2)
            raise ExchangeError(f"--mask {name}: no BPM or corrector has this name{hint}")
        measured = measured.without(its[1], PLANES if its[0] is None else (its[0],))
    return measured
