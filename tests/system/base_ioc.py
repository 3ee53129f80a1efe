"""A soft IOC of EPICS base: plain `ai` and `ao` records of a small ring, driven tick by tick.

    python base_ioc.py JOB.json

JOB is `{orbit_pvs, setpoint_pvs, readback_pvs, auxiliary: {pv: value}, rate_hz, read_only,
plant_seed, setpoint_record, bpm_unit, pva, records}`. All readings of a tick carry the stamp of one
record (TSEL). Without a plant BPM i reads `(tick % 1000) * 1e-3 + i * 1e-6` mm, so that a torn
orbit is seen in the values alone; with a `plant_seed` the BPMs see the default ring of that seed,
which answers the setpoints. A PV that is an element of an array (`PV.[3]`) makes a waveform record.
Faults are switched on by PVs: TEST:SKIP, TEST:NAN, TEST:INVALID hold the index of a BPM or -1.
Prints READY when it serves.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from epicscorelibs.ioc import dbCore
from softioc import imports, softioc

from orbitfb.core.names import named_pvs
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant

DBR_DOUBLE = 6  # CA numbering
DBF_DOUBLE = 10  # numbering of db_put_field_process
STAMP = "TEST:STAMP"
FAULTS = ("TEST:SKIP", "TEST:NAN", "TEST:INVALID")
INVALID_ABOVE = 1e6
DRIVE_LIMIT = 18

ACCESS = """
ASG(DEFAULT) { RULE(1, READ) RULE(1, WRITE) }
ASG(READONLY) { RULE(1, READ) }
"""


def database(job: dict) -> str:
    """Write the database of a ring."""
    reading = f'field(TSEL, "{STAMP}.TIME") field(MDEL, "-1") field(ADEL, "-1") field(VAL, "0")'
    alarm = f'field(HIHI, "{INVALID_ABOVE}") field(HHSV, "INVALID")'
    group = "READONLY" if job["read_only"] else "DEFAULT"
    drive = f'field(DRVH, "{DRIVE_LIMIT}") field(DRVL, "-{DRIVE_LIMIT}") field(ASG, "{group}")'
    zero = 'field(VAL, "0") field(PINI, "YES")'
    records = [f'record(ai, "{STAMP}") {{ field(TSE, "0") }}']
    records += [f'record(ao, "{pv}") {{ field(VAL, "-1") field(PINI, "YES") }}' for pv in FAULTS]
    unit = f'field(EGU, "{job["bpm_unit"]}")'
    limits = f'field(HOPR, "{DRIVE_LIMIT}") field(LOPR, "-{DRIVE_LIMIT}") field(ASG, "{group}")'
    for pvs, kind, fields, of_array in (
        (job["orbit_pvs"], "ai", f"{reading} {alarm} {unit}", unit),
        (job["readback_pvs"], "ai", reading, ""),
        (job["setpoint_pvs"], job["setpoint_record"], f"{drive} {zero}", limits),
    ):
        for pv in named_pvs(pvs):
            if pv.elements is None:
                records.append(f'record({kind}, "{pv.served}") {{ {fields} }}')
                continue
            size = f'field(FTVL, "DOUBLE") field(NELM, "{pv.length}")'
            stamp = "" if pvs is job["setpoint_pvs"] else f'field(TSEL, "{STAMP}.TIME")'
            records.append(f'record(waveform, "{pv.served}") {{ {size} {stamp} {of_array} }}')
    records += [
        f'record(ai, "{pv}") {{ field(VAL, "{value}") field(PINI, "YES") field(MDEL, "-1") }}'
        for pv, value in job["auxiliary"].items()
    ]
    return "\n".join([*records, job["records"]])


class Field:
    """The VAL field of one record, put and got by dbPutField and dbGetField."""

    def __init__(self, name: str, length: int = 1) -> None:
        self._name = name
        self.values = np.zeros(length)
        self._pointer = self.values.ctypes.data

    def put(self, value: float | np.ndarray) -> None:
        self.values[:] = value
        imports.db_put_field_process(self._name, DBF_DOUBLE, self._pointer, len(self.values), True)

    def get(self) -> float:
        imports.db_get_field(self._name, DBF_DOUBLE, self._pointer, len(self.values))
        return float(self.values[0])


class Vector:
    """The values of some PVs, which may be elements of arrays."""

    def __init__(self, names: list[str]) -> None:
        self._size = len(names)
        self._fields = [(pv, Field(pv.served, pv.length)) for pv in named_pvs(names)]

    def put(self, values: np.ndarray, skipped: int = -1) -> None:
        for pv, field in self._fields:
            if skipped in pv.places:
                continue
            whole = np.zeros(pv.length)
            whole[[0] if pv.elements is None else pv.elements] = values[pv.places]
            field.put(whole)

    def get(self) -> np.ndarray:
        values = np.zeros(self._size)
        for pv, field in self._fields:
            field.get()
            values[pv.places] = field.values[[0] if pv.elements is None else pv.elements]
        return values


def start(job: dict) -> None:
    """Load the database and begin to serve."""
    with tempfile.TemporaryDirectory() as folder:
        access, records = Path(folder, "access.acf"), Path(folder, "ring.db")
        access.write_text(ACCESS)
        records.write_text(database(job))
        dbCore.asSetFilename(str(access).encode())
        softioc.dbLoadDatabase(str(records))
        softioc.iocInit(dispatcher=lambda function, *arguments: None, enable_pva=job["pva"])


def run(job: dict) -> None:
    """Tick for ever."""
    bpms, readbacks = Vector(job["orbit_pvs"]), Vector(job["readback_pvs"])
    correctors, size = Vector(job["setpoint_pvs"]), len(job["orbit_pvs"])
    correctors.put(np.zeros(len(job["setpoint_pvs"])))
    slow = [(Field(pv), value) for pv, value in job["auxiliary"].items()]
    stamp, faults = Field(STAMP), [Field(pv) for pv in FAULTS]
    plant = None if job["plant_seed"] is None else Plant(Ring.load(), seed=job["plant_seed"])
    ring = Ring.load().channels("x").setpoint_pvs
    here = [ring.index(pv) for pv in job["setpoint_pvs"]] if plant else []
    period, tick = 1.0 / job["rate_hz"], 0
    due = time.monotonic()
    while True:
        due = max(due + period, time.monotonic() - period)
        time.sleep(max(0.0, due - time.monotonic()))
        tick += 1
        skip, nan, invalid = (int(fault.get()) for fault in faults)
        setpoints = correctors.get()
        if plant is None:
            orbit = (tick % 1000) * 1e-3 + np.arange(size) * 1e-6
        else:
            kicks = np.zeros(len(ring))  # those that another IOC has stay as they were
            kicks[here] = setpoints
            orbit = plant.step(kicks).reading * 1e3
        for field, value in slow if tick % 20 == 0 else ():
            field.put(value)
        stamp.put(tick)
        orbit = np.array(orbit, dtype=np.float64)
        for index, value in ((nan, np.nan), (invalid, 1e9)):
            if index >= 0:
                orbit[index] = value
        bpms.put(orbit, skip)
        readbacks.put(setpoints)


def main() -> None:
    """Serve the job named on the command line."""
    job = json.loads(Path(sys.argv[1]).read_text())
    start(job)
    sys.stdout.write("READY\n")
    sys.stdout.flush()
    run(job)


if __name__ == "__main__":
    main()
