"""Names of columns, and where the ring has them."""

import numpy as np

from orbitfb.diagnose.result.naming import column_names, devices_and_planes, geometry
from orbitfb.effects.build import layout_of
from orbitfb.physics.places import Ring
from orbitfb.records.layout import Devices, Layout


def test_names_stay_bare_while_they_are_unique():
    assert column_names(Devices(("A", "B"), ("x", "x"), ("", ""))) == ("A", "B")
    both = Devices(("A", "A"), ("x", "y"), ("", ""))
    assert column_names(both) == ("A (x)", "A (y)")


def test_the_default_ring_has_every_device_in_its_sector():
    ring = Ring.load()
    layout = layout_of(ring, "xy", 0.1)
    its = geometry(layout)
    assert len(its.bpms) == 2 * 180
    assert set(its.bpms) == set(column_names(layout.bpms))
    begins = np.array(its.sectors_m)
    assert np.all(np.diff(begins) > 0)
    for key, cell in zip(column_names(layout.bpms), layout.bpms.cells, strict=True):
        sector = np.searchsorted(begins, its.bpms[key], side="right") - 1
        assert its.sector_names[sector] == cell


def test_devices_of_no_ring_stand_nowhere():
    one = Devices(("A",), ("x",), ("C01",))
    assert geometry(Layout(one, one, np.eye(1), 0.1, None)).bpms == {}


def test_devices_are_named_without_planes_where_that_says_the_same():
    assert devices_and_planes(("A (x)", "A (y)")) == (("A",), "xy")
    assert devices_and_planes(("A (y)", "B (y)")) == (("A", "B"), "y")
    assert devices_and_planes(("A (x)", "B (y)")) == (("A (x)", "B (y)"), "xy")
    assert devices_and_planes(("A", "B")) == (("A", "B"), "xy")
    assert devices_and_planes(()) == ((), "xy")
