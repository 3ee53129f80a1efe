"""Check the stamps of a record."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.records.reading.raw import Raw

_PREFIXES = {3: "ms", 6: "us", 9: "ns"}
_EXACTLY = 0.004
"""Most that the factor between two periods may be beside a power of ten [decades]."""

_SHORTEST = 1e-3
"""Period below which float32 is not blamed where most stamps are equal [s]."""


def time_of(raw: Raw, time: Vector | None, rows: int, period: float | None) -> Vector:
    """Give the time of every row [s].

    Args:
        raw: For messages.
        time: Array 't', shape (rows,) [s]; None if it is missing.
        rows: How many there are.
        period: What meta says [s]; None if it does not.

    Raises:
        RecordError: There is neither, they are in two units, or the time does not increase.
    """
    if time is None:
        if period is None:
            raise raw.wrong("t", "is missing, and meta gives no dt_s", "add the time of every row")
        return np.arange(rows, dtype=np.float64) * period
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        row = int(back[0]) + 1
        problem = f"does not increase at row {row}"
        given = raw.numbers["t"]
        short = given.astype(np.float32)
        usual = float(np.median(np.abs(steps))) or _SHORTEST
        if np.array_equal(short, given) and np.spacing(short[row]) > usual:
            raise raw.wrong(
                "t",
                f"{problem}: it was saved as float32, which near {given[row]:.0f} tells only every "
                f"{np.spacing(short[row]):g}",
                "save it as float64, or count from the first row",
            )
        if not steps.any():
            raise raw.wrong(
                "t",
                f"{problem}: it is {time[0]:g} s in every row",
                "save the time at which each orbit was read, or leave 't' out and give dt_s in "
                "meta",
            )
        raise raw.wrong(
            "t",
            f"{problem}: {time[row]:.6f} s after {time[row - 1]:.6f} s ({len(back)} such rows)",
            "put the rows in the order in which they were read, each once",
        )
    if len(steps) and period is not None:
        _check_unit(raw, float(np.median(steps)), period)
    return time


def _check_unit(raw: Raw, measured: float, period: float) -> None:
    """See that meta's period is not exactly 1000, 1e6 or 1e9 times that of the stamps, or less."""
    decades = math.log10(measured / period)
    for power, unit in _PREFIXES.items():
        if abs(abs(decades) - power) < _EXACTLY:
            raise raw.wrong(
                "t",
                f"says that orbits are {measured:.4g} s apart, meta says dt_s = {period:g}, a "
                f"factor of 1e{power}",
                f'if t is in {unit}, say so in meta: "units": {{"t": "{unit}"}}'
                if decades > 0
                else "both are in seconds, but for a t that has its unit in meta: correct one",
            )
