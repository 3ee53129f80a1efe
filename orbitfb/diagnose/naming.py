"""Names of the columns of a record in a diagnosis, and where they stand."""

from collections.abc import Iterable, Sequence

import numpy as np

from orbitfb.diagnose.answer_blocks import Geometry
from orbitfb.diagnose.answer_parts import Cause
from orbitfb.diagnose.result.naming import column_names
from orbitfb.effects.registry import all_effects
from orbitfb.records.layout import Devices, Layout


def as_in_record(causes: Sequence[Cause], layout: Layout) -> tuple[Cause, ...]:
    """Give the places of causes the names that the record has for them.

    Args:
        causes: On devices by their names in the places table.
        layout: Of the record.
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

    within = channels(cause.places_within)
    return cause.model_copy(update={"places": channels(cause.places), "places_within": within})


def geometry(layout: Layout) -> Geometry:
    """Tell where the devices stand and where sectors begin; empty without a ring."""
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
