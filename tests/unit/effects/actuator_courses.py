"""Courses of setpoints, and how a record and the plant answer them."""

import numpy as np

from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record

ROWS, PLACES = 150, np.array([2, 3, 5])


def few(layout, count=8):
    """The same ring with its first correctors and BPMs only, to be quick."""

    def cut(devices):
        return Devices(devices.names[:count], devices.planes[:count], devices.cells[:count])

    return Layout(
        cut(layout.bpms),
        cut(layout.correctors),
        layout.response[:count, :count],
        layout.period,
        layout.ring,
    )


def record_of(layout, setpoints, starts=(0,), readback=None):
    rows, begins = len(setpoints), np.zeros(len(setpoints), dtype=bool)
    begins[list(starts)] = True
    readings = np.zeros((rows, len(layout.bpms)))
    return Record(
        layout=layout,
        time=np.arange(rows) * layout.period,
        starts=begins,
        readings=readings,
        setpoints=setpoints,
        requested=np.zeros_like(setpoints),
        readback=readback,
        dither=None,
        reference=None,
        filled=np.zeros(readings.shape, dtype=bool),
        auxiliary={},
        source="test",
        digest="",
    )


def course(seed, columns, rows=ROWS, size=4e-3):
    """Setpoints that wander, with steps of all sizes, standstills and reversals."""
    rng = np.random.default_rng(seed)
    steps = size * rng.standard_normal((rows, columns)) * rng.choice([0, 0.1, 1, 3], (rows, 1))
    return 0.03 * rng.standard_normal(columns) + np.cumsum(steps, axis=0)


def run(made, setpoints):
    """Currents that the plant's hook makes, tick by tick; refuses changed arguments."""
    currents = np.empty_like(setpoints)
    for tick, row in enumerate(setpoints):
        given_row = row.copy()
        given_row.setflags(write=False)
        currents[tick] = made.actuate(given_row, tick)
    return currents


def simulated(kind, layout, values, setpoints, places=PLACES, seed=0):
    return run(kind.simulate(layout, places, values, np.random.default_rng(seed)), setpoints)


def driven(kind, layout, values, setpoints, places=PLACES, starts=(0,)):
    record = record_of(layout, setpoints, starts)
    currents = setpoints.copy()
    columns = slice(None) if kind.target == "ring" else places
    currents[:, columns] = kind.drive(setpoints[:, columns], values, record)
    return currents


def nominal(kind):
    return {p.name: p.nominal for p in kind.parameters}
