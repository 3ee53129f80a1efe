"""Setpoints in an array: whole puts, with the others as they are in force."""

import ctypes

import numpy as np
import pytest
from fake_libca import Bench, FakeLibrary

from orbitfb.core.errors import MachineError, WriteError
from orbitfb.epics.connecting import wait_for_channels
from orbitfb.epics.libca import DBR_CTRL_DOUBLE, ECA_NORMAL
from orbitfb.epics.settings import EpicsSettings


class ArrayLibrary(FakeLibrary):
    """Gets and puts of one array, COR."""

    def __init__(self):
        super().__init__()
        self.array, self.sent, self.sizes = np.zeros(3), [], {}

    def ca_element_count(self, handle):
        return self.sizes.get(self.name_of(handle), 3)

    def ca_array_get(self, kind, count, handle, address):
        if self.name_of(handle) != "COR" or kind == DBR_CTRL_DOUBLE:
            return super().ca_array_get(kind, count, handle, address)
        ctypes.memmove(address, self.array.ctypes.data, 8 * count)
        return ECA_NORMAL

    def ca_array_put(self, _kind, count, handle, address):
        if self.name_of(handle) == "COR":
            values = (ctypes.c_double * count.value).from_address(address.value)
            self.sent.append(list(values))
            self.array = np.array(values)
        return ECA_NORMAL


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr("fake_libca.FakeLibrary", ArrayLibrary)
    return Bench(monkeypatch, names=("COR.[0]", "COR.[2]", "COR.[1]"))


def post(bench, values):
    """Let the server show values, in the order of the array."""
    watch = bench.machine._setpoints.watch
    for place, element in enumerate((0, 2, 1)):
        watch.records["value"][place] = values[element]


FIRST = np.array([True, False, False])


def test_they_are_read_and_written_by_element(bench):
    bench.library.array = np.array([1.0, 2.0, 3.0])
    assert bench.machine.setpoints().tolist() == [1.0, 3.0, 2.0]
    bench.machine.write(np.array([0.1, 0.3, 0.2]))
    assert bench.library.sent == [[0.1, 0.2, 0.3]]


def test_one_is_put_with_the_others_as_we_left_them(bench):
    post(bench, [0.0, 0.0, 0.0])
    bench.machine.write(np.array([0.1, 0.3, 0.2]))
    bench.machine.write(np.array([0.4, np.nan, np.nan]), FIRST)  # nothing was posted since
    bench.machine.write(np.array([0.6, 0.8, 0.7]))
    post(bench, [0.1, 0.2, 0.3])  # a late echo of the first
    bench.machine.write(np.array([0.5, np.nan, np.nan]), FIRST)
    assert bench.library.sent[1:] == [[0.4, 0.2, 0.3], [0.6, 0.7, 0.8], [0.5, 0.7, 0.8]]


def test_what_somebody_else_has_put_meanwhile_stays(bench):
    bench.machine.write(np.array([0.1, 0.3, 0.2]))
    post(bench, [0.1, 0.2, 0.9])
    bench.machine.write(np.array([0.4, np.nan, np.nan]), FIRST)
    bench.machine.write(np.array([0.5, np.nan, np.nan]), FIRST)
    assert bench.library.sent[1:] == [[0.4, 0.2, 0.9], [0.5, 0.2, 0.9]]


def test_nothing_is_put_where_nothing_is_asked_for(bench):
    bench.machine.write(np.zeros(3), np.zeros(3, dtype=bool))
    assert bench.library.sent == []


def test_neighbours_that_are_not_known_are_not_overwritten(bench):
    bench.library.array = np.array([1.0, np.nan, 3.0])
    with pytest.raises(MachineError):
        bench.machine.setpoints()
    bench.machine._setpoints._last[:] = np.nan
    with pytest.raises(WriteError, match=r"2 setpoints are not known.*COR\.\[2\], COR\.\[1\]"):
        bench.machine.write(np.array([0.4, np.nan, np.nan]), FIRST)
    assert bench.library.sent == []


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (2, "COR holds 2 values, and element 2 is named"),
        (4, "COR holds 4 values, of which 3 are named"),
    ],
)
def test_an_array_of_another_size_is_refused_at_the_start(bench, size, words):
    bench.library.sizes["COR"] = size
    group = bench.setpoints
    group.lengths[:] = size
    with pytest.raises(MachineError, match=words):
        wait_for_channels((group,), group, EpicsSettings(connect_timeout=0.01), bench.clock)
