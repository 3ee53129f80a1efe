"""A soft IOC of EPICS base: plain `ai` and `ao` records of a small ring, driven tick by tick.

    python base_ioc.py JOB.json

JOB is `{orbit_pvs, setpoint_pvs, readback_pvs, auxiliary: {pv: value}, rate_hz, read_only,
plant_seed, setpoint_record, bpm_unit}`. All readings of a tick carry the stamp of one record
(TSEL). Without a plant BPM i reads `(tick % 1000) * 1e-3 + i * 1e-6` mm, so that a torn orbit is
seen in the values alone; with a `plant_seed` the BPMs see the default ring of that seed, which
answers the setpoints. Faults are switched on by PVs: TEST:SKIP, TEST:NAN, TEST:INVALID hold the
index of a BPM or -1.
Prints READY when it serves.
"""

import ctypes
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from epicscorelibs.ioc import dbCore
from softioc import imports, softioc

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
    records = [f'record(ai, "{STAMP}") {{ field(TSE, "0") }}']
    records += [f'record(ao, "{pv}") {{ field(VAL, "-1") field(PINI, "YES") }}' for pv in FAULTS]
    unit = f'field(EGU, "{job["bpm_unit"]}")'
    records += [f'record(ai, "{pv}") {{ {reading} {alarm} {unit} }}' for pv in job["orbit_pvs"]]
    records += [f'record(ai, "{pv}") {{ {reading} }}' for pv in job["readback_pvs"]]
    records += [
        f'record({job["setpoint_record"]}, "{pv}") {{ {drive} field(VAL, "0") field(PINI, "YES") }}'
        for pv in job["setpoint_pvs"]
    ]
    records += [
        f'record(ai, "{pv}") {{ field(VAL, "{value}") field(PINI, "YES") field(MDEL, "-1") }}'
        for pv, value in job["auxiliary"].items()
    ]
    return "\n".join(records)


class Field:
    """One VAL field that is put or got by dbPutField and dbGetField."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._value = ctypes.c_double()
        self._pointer = ctypes.addressof(self._value)

    def put(self, value: float) -> None:
        self._value.value = value
        imports.db_put_field_process(self._name, DBF_DOUBLE, self._pointer, 1, True)

    def get(self) -> float:
        imports.db_get_field(self._name, DBF_DOUBLE, self._pointer, 1)
        return self._value.value


def start(job: dict) -> None:
    """Load the database and begin to serve."""
    with tempfile.TemporaryDirectory() as folder:
        access, records = Path(folder, "access.acf"), Path(folder, "ring.db")
        access.write_text(ACCESS)
        records.write_text(database(job))
        dbCore.asSetFilename(str(access).encode())
        softioc.dbLoadDatabase(str(records))
        softioc.iocInit(dispatcher=lambda function, *arguments: None, enable_pva=False)


def run(job: dict) -> None:
    """Tick for ever."""
    bpms = [Field(pv) for pv in job["orbit_pvs"]]
    pairs = [
        (Field(readback), Field(setpoint))
        for readback, setpoint in zip(job["readback_pvs"], job["setpoint_pvs"], strict=True)
    ]
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
        setpoints = [setpoint.get() for _, setpoint in pairs]
        if plant is None:
            orbit = (tick % 1000) * 1e-3 + np.arange(len(bpms)) * 1e-6
        else:
            kicks = np.zeros(len(ring))  # those that another IOC has stay as they were
            kicks[here] = setpoints
            orbit = plant.step(kicks).reading * 1e3
        for field, value in slow if tick % 20 == 0 else ():
            field.put(value)
        stamp.put(tick)
        for index, (bpm, value) in enumerate(zip(bpms, orbit, strict=True)):
            if index == skip:
                continue
            bpm.put(float("nan") if index == nan else 1e9 if index == invalid else value)
        for (readback, _), value in zip(pairs, setpoints, strict=True):
            readback.put(value)


def main() -> None:
    """Serve the job named on the command line."""
    job = json.loads(Path(sys.argv[1]).read_text())
    start(job)
    sys.stdout.write("READY\n")
    sys.stdout.flush()
    run(job)


if __name__ == "__main__":
    main()
