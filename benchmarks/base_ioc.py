"""The same ring behind records of EPICS base: the leanest such IOC that Python can drive.

    python -m benchmarks.base_ioc PORT SIZE < JOB

SIZE 0 is the job's own ring. Plain soft `ai` and `ao` records, and `waveform` records for arrays;
per tick Python steps the ring and calls dbPutField once per record of readings and dbGetField once
per record of setpoints through ctypes, with addresses looked up beforehand. All readings take the
time stamp of one record (TSEL). The put of the last corrector wakes the ring in lockstep (FLNK to
one record with a Python callback); no other record runs Python.
"""

import ctypes
import gc
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from epicscorelibs.ioc import dbCore
from softioc import builder, softioc

from benchmarks.rings import build_ring
from orbitfb.core.names import NamedPv, any_over_pva, named_pvs
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import Layout, lay_out

STAMP = "BENCH:STAMP"
DONE = "BENCH:DONE"
_DOUBLE = ctypes.c_short(10)  # DBR_DOUBLE of dbAccess.h, which is not that of Channel Access
_ADDRESS_SIZE = 64  # struct dbAddr has 40 bytes


class Fields:
    """The VAL fields of some records, put or got one after the other without allocating.

    Args:
        names: PVs, or elements of arrays in their order.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.values = np.zeros(len(names))
        options = ctypes.c_long(0)
        self._put, self._get = dbCore["dbPutField"], dbCore["dbGetField"]
        self._puts, self._gets = [], []
        for pv in named_pvs(names):
            address, count = _address(pv.served), ctypes.c_long(pv.length)
            pointer = ctypes.c_void_p(self.values.ctypes.data + 8 * int(pv.places[0]))
            self._puts.append((address, _DOUBLE, pointer, count))
            its = (address, _DOUBLE, pointer, ctypes.byref(options), ctypes.byref(count), None)
            self._gets.append(its)

    def put(self) -> None:
        put = self._put
        for call in self._puts:
            put(*call)

    def get(self) -> np.ndarray:
        get = self._get
        for call in self._gets:
            get(*call)
        return self.values.copy()


def _address(name: str) -> ctypes.Array:
    address = ctypes.create_string_buffer(_ADDRESS_SIZE)
    if dbCore.dbNameToAddr(name.encode(), address):
        raise SystemExit(f"no record {name}")
    return address


def _array(pv: NamedPv) -> str:
    return f'field(FTVL, "DOUBLE") field(NELM, "{pv.length}")'


def database(layout: Layout) -> str:
    """Write the records of a ring: every reading is posted at every tick (MDEL -1)."""
    reading = f'field(TSEL, "{STAMP}.TIME") field(MDEL, "-1") field(ADEL, "-1") field(VAL, "0")'
    records = [f'record(ai, "{STAMP}") {{ field(TSE, "0") }}']
    specs = {spec.name: spec for spec in (*layout.readings, *layout.setpoints)}
    correctors = named_pvs([spec.name for spec in layout.setpoints[: layout.correctors]])
    for pv in named_pvs([spec.name for spec in layout.readings]):
        kind = "ai" if pv.elements is None else "waveform"
        fields = reading if pv.elements is None else f'{_array(pv)} field(TSEL, "{STAMP}.TIME")'
        records.append(f'record({kind}, "{pv.served}") {{ {fields} }}')
    for pv in named_pvs([spec.name for spec in layout.setpoints]):
        link = f'field(FLNK, "{DONE}")' if pv.name == correctors[-1].name else ""
        if pv.elements is None:
            low, high = specs[pv.name].drive
            drive = f'field(DRVH, "{high}") field(DRVL, "{low}")'
            value = f'field(VAL, "{specs[pv.name].initial}") field(PINI, "YES")'
            records.append(f'record(ao, "{pv.served}") {{ {drive} {value} {link} }}')
        else:
            records.append(f'record(waveform, "{pv.served}") {{ {_array(pv)} {link} }}')
    return "\n".join(records)


def _at_once(
    call: Callable[..., Any], func_args: Any = (), completion: Any = None, completion_args: Any = ()
) -> None:
    call(*func_args)


def main() -> None:
    port, size = int(sys.argv[1]), int(sys.argv[2])
    job = SimJob.model_validate_json(sys.stdin.buffer.readline())
    ring, settings = build_ring(job, size or None)
    layout = lay_out(ring.channels, settings)
    written = threading.Event()
    builder.SetDeviceName("BENCH")
    builder.aOut("DONE", on_update=lambda _value: written.set(), always_update=True)
    builder.LoadDatabase()
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder, "ring.db")
        records.write_text(database(layout))
        softioc.dbLoadDatabase(str(records))
        softioc.iocInit(dispatcher=_at_once, enable_pva=any_over_pva(ring.channels.pvs))
    stamp = Fields([STAMP])
    readings = Fields([spec.name for spec in layout.readings])
    setpoints = Fields([spec.name for spec in layout.setpoints])
    setpoints.values[:] = [spec.initial for spec in layout.setpoints]
    setpoints.put()  # a waveform that nobody has written to has no values
    gc.collect()
    gc.freeze()
    sys.stdout.write(f"READY port={port} pvs={len(layout)}\n")
    sys.stdout.flush()

    period = 1.0 / settings.rate_hz
    due = time.monotonic()
    while True:
        if settings.lockstep:
            written.wait(period)
            written.clear()
        else:
            due = max(due + period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
        stamp.put()
        values = setpoints.get()
        rf = float(values[-1])
        state = ring.step(values[: layout.correctors], rf - layout.rf_frequency)
        readings.values[:] = layout.values(state, ring.tick, rf=rf)
        readings.put()


if __name__ == "__main__":
    main()
