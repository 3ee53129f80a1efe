"""Small records as files, right ones to be spoilt."""

from functools import cache

import numpy as np

from benchmarks.save import exchange_arrays
from benchmarks.simulate import simulate_record
from orbitfb.physics.places import Ring


@cache
def ring():
    return Ring.load()


@cache
def record(planes="x", ticks=120, seed=0, **settings):
    return simulate_record(ring(), planes, ticks, seed, **settings)


def arrays(planes="x", **settings):
    """The arrays of a right record, without the hints of `meta`."""
    made = dict(exchange_arrays(record(planes, **settings)))
    del made["meta"]
    return made


def small(planes="x", bpms=12, correctors=10):
    """The arrays of a record of few devices, rows and columns in no order."""
    made = arrays(planes)
    rng = np.random.default_rng(0)
    rows = rng.permutation(180)[:bpms]
    columns = rng.permutation(180)[:correctors]
    if planes == "xy":
        rows, columns = np.append(rows, rows + 180), np.append(columns, columns + 180)
    for name in ("orbit", "next_orbit", "reference"):
        made[name] = made[name][:, rows]
    for name in ("action", "setpoint"):
        made[name] = made[name][:, columns]
    made["model_R"] = made["model_R"][np.ix_(rows, columns)]
    made["bpm_names"], made["corr_names"] = made["bpm_names"][rows], made["corr_names"][columns]
    return made


def save(path, made):
    np.savez_compressed(path, **made)
    return path
