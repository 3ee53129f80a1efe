"""Pictures of a post-mortem: the courses around the trip, and the orbit at three moments."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from orbitfb.core.signals import Vector
from orbitfb.html.figures import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, RED, SKY, shorten
from orbitfb.postmortem.analysis import CURRENT, Analysis
from orbitfb.postmortem.content import PHASES
from orbitfb.postmortem.devices import error_of
from orbitfb.postmortem.reading import PostMortem

_ABOVE: dict[str, Any] = {
    "loc": "lower left",
    "bbox_to_anchor": (0.0, 0.97),
    "frameon": False,
    "borderaxespad": 0.1,
}
"""Where a legend stands: over the axes, on no line."""

_STATES = {
    "OPEN": SKY,
    "SHADOW": PURPLE,
    "CLOSED": GREEN,
    "HELD": ORANGE,
    "TRIPPED": RED,
    "FAULT": BLACK,
}


def courses(figure: Figure, its: PostMortem, found: Analysis) -> None:
    """Draw orbit, current, kicks and phases over time, one below the other."""
    rows = figure.subplots(5, 1, sharex=True, height_ratios=(2.2, 2.2, 1.1, 1.5, 1.3))
    orbit, picture, current, kicks, phases = rows
    since = its.columns["since_trip"]
    _orbit(orbit, its, found)
    _map(figure, picture, its)
    known = its.columns.get(CURRENT, np.full(its.rows, np.nan))
    current.plot(since, known * 1e3, color=PURPLE, lw=1.2)
    current.set_ylabel("current [mA]")
    current.set_ylim(0.0, None)
    _kicks(kicks, its)
    for index, (phase, colour) in enumerate(
        zip(PHASES[1:], (BLUE, GREEN, ORANGE, RED), strict=True), 1
    ):
        phases.plot(since, its.columns["phases"][:, index] * 1e3, color=colour, lw=0.9, label=phase)
    phases.set_ylabel("phase [ms]")
    phases.legend(ncols=4, **_ABOVE)
    phases.set_xlabel("time after the trip [s]")
    for axes in rows:
        axes.axvline(0.0, color=BLACK, lw=0.9, ls="--")
    if its.rows > 1 and since[-1] > since[0]:
        phases.set_xlim(since[0], since[-1])


def orbits(figure: Figure, its: PostMortem, found: Analysis) -> None:
    """Draw the orbit error along the ring: as it was, when it began to leave, at the trip."""
    axes = figure.subplots()
    error = error_of(its) * 1e6
    place = np.arange(error.shape[1])
    usual = error[found.usual]
    if len(usual) and np.isfinite(usual).any():
        known = np.isfinite(usual).any(axis=0)
        middle = np.full(error.shape[1], np.nan)
        middle[known] = np.nanmedian(usual[:, known], axis=0)
        axes.plot(place, middle, color=BLUE, lw=1.2, label="before")
    if found.onset is not None and found.onset != found.trip:
        when = its.columns["since_trip"][found.onset]
        label = f"beginning to leave ({when:+.2f} s)"
        axes.plot(place, error[found.onset], color=ORANGE, lw=1.0, label=label)
    axes.plot(place, error[found.trip], color=RED, lw=1.0, label="at the trip")
    if found.bpm is not None and found.bpm.name in its.channels.bpms:
        where = its.channels.bpms.index(found.bpm.name)
        axes.axvline(where, color=GREY, lw=0.9, ls=":", label=f"first: {shorten(found.bpm.name)}")
    if its.channels.planes == "xy":
        axes.axvline(error.shape[1] / 2 - 0.5, color=GREY, lw=0.6)
        axes.set_xlabel("BPM, in the order of the ring: x, then y")
    else:
        axes.set_xlabel(f"BPM, in the order of the ring ({its.channels.planes})")
    axes.set_ylabel("orbit error [µm]")
    axes.axhline(0.0, color=GREY, lw=0.5)
    axes.legend(ncols=4, **_ABOVE)


def _orbit(axes: Axes, its: PostMortem, found: Analysis) -> None:
    """Draw the size of the orbit error over bands for the states."""
    since = its.columns["since_trip"]
    axes.plot(since, found.largest * 1e6, color=GREY, lw=0.9, label="largest")
    axes.plot(since, found.rms * 1e6, color=BLUE, lw=1.3, label="rms")
    if (np.nan_to_num(found.rms) > 0).any():
        axes.set_yscale("log")
    axes.set_ylabel("orbit error [µm]")
    if found.onset is not None:
        axes.axvline(float(since[found.onset]), color=ORANGE, lw=0.9, ls=":", label="it leaves")
    states = its.columns["state"]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(states)) + 1]).astype(int)
    named = its.states()
    shown: set[str] = set()
    for first, last in zip(starts, [*starts[1:], its.rows - 1], strict=True):
        name = named[first].value
        axes.axvspan(
            float(since[first]),
            float(since[last]),
            color=_STATES.get(name, GREY),
            alpha=0.13,
            lw=0,
            label=None if name in shown else name,
        )
        shown.add(name)
    axes.legend(ncols=len(shown) + 3, **_ABOVE)


def _map(figure: Figure, axes: Axes, its: PostMortem) -> None:
    """Draw the orbit error of every BPM over time; invalid ones stay white."""
    since, error = its.columns["since_trip"], error_of(its) * 1e6
    known = np.abs(error[np.isfinite(error)])
    most = max(float(known.max()) if len(known) else 1.0, 1e-2)
    usual = max(float(np.median(known)) if len(known) else 1.0, 1e-3 * most)
    drawn = axes.pcolormesh(
        _edges(since),
        np.arange(error.shape[1] + 1) - 0.5,
        np.ma.masked_invalid(error.T),
        cmap="RdBu_r",
        norm=SymLogNorm(2.0 * usual, vmin=-most, vmax=most),
        rasterized=True,
    )
    figure.colorbar(drawn, ax=axes, label="error [µm]", pad=0.01)
    axes.set_ylabel("BPM")


def _kicks(axes: Axes, its: PostMortem) -> None:
    """Draw what was written, and how far the readbacks are from the setpoints."""
    since, columns = its.columns["since_trip"], its.columns
    axes.plot(
        since, np.abs(columns["applied"]).max(axis=1) * 1e3, color=GREEN, lw=1.1, label="written"
    )
    away = np.abs(columns["readback"] - columns["setpoints"])
    known = np.isfinite(away).any(axis=1)
    gap = np.full(its.rows, np.nan)
    gap[known] = np.nanmax(away[known], axis=1)
    axes.plot(since, gap * 1e3, color=RED, lw=0.9, label="readback off setpoint")
    axes.set_ylabel("largest [mA]")
    axes.set_yscale("symlog", linthresh=0.1)
    axes.legend(ncols=2, **_ABOVE)


def _edges(since: Vector) -> Vector:
    """Give the edges of cells around times, shape (rows + 1,)."""
    if len(since) == 1:
        return np.array([since[0] - 0.05, since[0] + 0.05])
    middle = (since[1:] + since[:-1]) / 2
    first, last = since[0] - (middle[0] - since[0]), since[-1] + (since[-1] - middle[-1])
    return np.maximum.accumulate(np.concatenate([[first], middle, [last]]))
