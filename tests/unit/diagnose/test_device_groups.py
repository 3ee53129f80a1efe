"""Groups of devices, whatever their names tell."""

from dataclasses import replace

import numpy as np
import pytest
from test_scans import LAYOUT, best, record_with

from orbitfb.diagnose.device_groups import cells, groups_of
from orbitfb.records.layout import Devices

NAMELESS = Devices(tuple(f"BPM{i}" for i in range(60)) * 2, ("x",) * 60 + ("y",) * 60, ("",) * 120)


def test_where_no_cell_is_known_runs_of_neighbours_are_groups_in_each_plane_and_both():
    found = {tuple(its.members.tolist()): its.name for its in groups_of(NAMELESS)}
    assert len(found) < 60 * 3 * 12
    assert found[tuple(range(60))] == "all x"
    assert found[7, 8, 9] == "BPM7–BPM9 x"
    assert found[67, 68, 69] == "BPM7–BPM9 y"
    assert found[7, 8, 9, 67, 68, 69] == "BPM7–BPM9"
    assert max(len(columns) for columns in found) == 120
    covered = {int(column) for members in cells(NAMELESS) for column in members}
    assert covered == set(range(120))


def test_a_rack_need_not_begin_with_a_cell_nor_end_before_the_ring_does():
    devices = LAYOUT.correctors
    found = {its.members.tobytes(): its.name for its in groups_of(devices)}
    assert len(found) == len(groups_of(devices))  # none twice
    last = len(devices) - 1
    for columns, name in (
        ([4, 5, 6, 7], f"{devices.names[4]}–{devices.names[7]}"),
        ([0, 1, last - 1, last], f"{devices.names[last - 1]}–{devices.names[1]}"),
        ([0, 1, 2, 3, 4, 5], devices.cells[0]),
    ):
        assert found[np.array(columns, dtype=np.intp).tobytes()] == name
    assert sum(1.0 / its.choices for its in groups_of(devices)) == pytest.approx(1.0)


@pytest.mark.parametrize("cells", [("C1",) * 6 + ("C2",) * 6, ("C1",) * 12])
def test_planes_of_other_names_are_two_rings_and_no_group_is_listed_twice(cells):
    names = tuple(f"{p}{number}" for p in "HV" for number in range(12))
    devices = Devices(names, ("x",) * 12 + ("y",) * 12, cells * 2)
    found = [tuple(its.members.tolist()) for its in groups_of(devices)]
    assert len(found) == len(set(found))
    assert (0, 1, 2, 11) in found and (12, 13, 22, 23) in found
    assert (11, 12) not in found and (0, 23) not in found
    assert not any(its.members.flags.writeable for its in groups_of(devices))


def test_neighbours_without_a_cell_are_found_together():
    struck = LAYOUT.bpms.names[20:24]
    record = record_with(f"bpm-gain:gain=0.05,names={'+'.join(struck)}", dither=2e-3)
    nameless = replace(record.layout.bpms, cells=("",) * len(record.layout.bpms))
    record = replace(record, layout=replace(record.layout, bpms=nameless))
    assert best(record, "bpm-gain").cause.places == (20, 21, 22, 23)
