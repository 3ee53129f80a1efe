"""Names and positions of the devices of a record in a diagnosis."""

from collections.abc import Iterable, Sequence

import numpy as np

from orbitfb.diagnose.result.blocks import Geometry
from orbitfb.diagnose.result.parts import Cause
from orbitfb.effects.registry import all_effects
from orbitfb.physics.places import Planes
from orbitfb.records.layout import Devices, Layout


def column_names(devices: Devices) -> tuple[str, ...]:
    """Name the columns for the keys of `by_bpm` and `by_corrector`.

    The bare names where they are unique, otherwise (both planes) each with its plane.
    """
    if len(set(devices.names)) == len(devices):
        return devices.names
    return tuple(devices.label(column) for column in range(len(devices)))


def devices_and_planes(labels: Sequence[str]) -> tuple[tuple[str, ...], Planes]:
    """Name devices without their planes, if no information is lost.

    Args:
        labels: Names, such as `CL1B_C24 (x)` where a plane belongs to them.

    Returns:
        The devices, and their planes. Names keep their planes if some devices are meant in one
        plane and others in the other.
    """
    devices: dict[str, dict[str, None]] = {"x": {}, "y": {}}
    for label in labels:
        name, _, plane = label.removesuffix(")").rpartition(" (")
        if plane not in devices or not name:
            return tuple(labels), "xy"
        devices[plane][name] = None
    x, y = devices["x"], devices["y"]
    if x.keys() == y.keys():
        return tuple(x), "xy"
    if not y:
        return tuple(x), "x"
    return (tuple(labels), "xy") if x else (tuple(y), "y")


def as_in_record(causes: Sequence[Cause], layout: Layout) -> tuple[Cause, ...]:
    """Rename the places of causes as the record names them.

    Args:
        causes: Causes with the device names of the places table.
        layout: Layout of the record.
    """
    return tuple(_as_in_record(cause, layout) for cause in causes)


def _as_in_record(cause: Cause, layout: Layout) -> Cause:
    target = all_effects()[cause.effect].target
    devices = {"bpm": layout.bpms, "corrector": layout.correctors}.get(target)
    if devices is None or not devices.channels:
        return cause
    its = devices

    def channels(places: Sequence[str]) -> tuple[str, ...]:
        return tuple(
            its.channels[column]
            for place in places
            for column in range(len(its))
            if place == its.label(column)
            or (place == its.names[column] and its.planes[column] in cause.planes)
        )

    return cause.model_copy(
        update={
            "places": channels(cause.places),
            "places_within": channels(cause.places_within),
            "by_place": tuple(
                one.model_copy(update={"places": channels(one.places)}) for one in cause.by_place
            ),
        }
    )


def geometry(layout: Layout) -> Geometry:
    """Give the positions of devices and sectors; empty without a ring."""
    if layout.ring is None:
        return Geometry()
    table = layout.ring.table
    position = dict(zip(table.name, table.s.tolist(), strict=True))

    def standing(devices: Devices) -> dict[str, float | None]:
        return {
            key: position.get(name)
            for key, name in zip(column_names(devices), devices.names, strict=True)
        }

    cells = _cells(position, (layout.bpms, layout.correctors))
    begins, names = _begins(cells)
    return Geometry(
        bpms=standing(layout.bpms),
        correctors=standing(layout.correctors),
        sectors_m=begins,
        sector_names=names,
        circumference_m=layout.ring.parameters.circumference,
    )


def _cells(position: dict[str, float], groups: Iterable[Devices]) -> list[tuple[float, str]]:
    """Position and cell of every device that has both, in ring order."""
    found = {
        (position[name], cell)
        for devices in groups
        for name, cell in zip(devices.names, devices.cells, strict=True)
        if cell and name in position
    }
    return sorted(found)


def _begins(cells: list[tuple[float, str]]) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Half-way between the last device of one cell and the first of the next."""
    begins: list[float] = []
    names: list[str] = []
    for index, (place, cell) in enumerate(cells):
        if not names or cell != names[-1]:
            before = cells[index - 1][0] if index else 0.0
            begins.append(float(np.mean((before, place))))
            names.append(cell)
    return tuple(begins), tuple(names)
