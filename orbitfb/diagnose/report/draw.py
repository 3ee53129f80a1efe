"""What the pictures of a report share: how they get into the page, colours, the ring as an axis."""

import base64
import io
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from orbitfb.core.signals import Vector
from orbitfb.diagnose.report.html import text
from orbitfb.diagnose.result.blocks import Geometry

BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#1d2329", "#8a949d"
"""Colours that people with any colour vision can tell apart (Okabe and Ito)."""

STAGES = {
    "sensor": BLUE,
    "actuator": RED,
    "optics": GREEN,
    "disturbance": ORANGE,
    "noise": PURPLE,
    "timing": SKY,
}
"""Colour of every stage; what is of no stage is grey."""

NOT_RESOLVED: dict[str, Any] = {
    "facecolor": "#eef0f2",
    "edgecolor": GREY,
    "hatch": "////",
    "linewidth": 0.6,
}
"""Look of a bar whose interval covers zero."""

_LOOK: dict[Any, Any] = {
    "svg.hashsalt": "orbitfb",
    "svg.fonttype": "path",
    "font.size": 9,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "hatch.linewidth": 0.6,
    "image.interpolation": "nearest",
}
_NAMES_ON_AXIS = 24


def picture(caption: str, size: tuple[float, float], paint: Callable[[Figure], None]) -> str:
    """Draw a figure and write it into the page, as SVG.

    Args:
        caption: Below it, and read out in its place.
        size: Width and height [inch].
        paint: Draws it.
    """
    buffer = io.BytesIO()
    with mpl.rc_context(_LOOK), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # names in scripts without a font
        figure = Figure(figsize=size, layout="constrained", facecolor="none")
        FigureCanvasSVG(figure)
        paint(figure)
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    said = text(caption)
    return (
        f'<figure><img alt="{said}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{said}</figcaption></figure>"
    )


def values(numbers: Sequence[float | None]) -> Vector:
    """Make an array of numbers; NaN where one is not resolved."""
    return np.array([np.nan if number is None else number for number in numbers], dtype=float)


def rounded(number: float, among: Sequence[float] | Vector) -> str:
    """Write a number in three digits; what is nothing beside its neighbours is 0."""
    largest = float(np.nanmax(np.abs(among))) if len(among) else 0.0
    return "0" if abs(number) <= 1e-6 * largest else f"{number:.3g}"


def known(numbers: Sequence[float | None]) -> bool:
    """Tell whether there is any number to draw."""
    return any(number is not None for number in numbers)


def whiskers(
    middle: Sequence[float | None], low: Sequence[float | None], high: Sequence[float | None]
) -> np.ndarray:
    """Make error bars from intervals, shape (2, k); none where an end is not known."""
    centre = values(middle)
    bars = np.array([centre - values(low), values(high) - centre])
    return np.clip(np.nan_to_num(bars), 0.0, None)


def along(axes: Axes, names: Sequence[str], where: dict[str, float | None] | None) -> Vector:
    """Take the ring as the horizontal axis where every place is known, else the order.

    Returns:
        Position of every name on the axis, shape (k,).
    """
    places = [where.get(name) for name in names] if where else []
    if places and all(place is not None for place in places):
        axes.set_xlabel("s [m]")
        return values(places)
    positions = np.arange(len(names), dtype=float)
    if len(names) <= _NAMES_ON_AXIS:
        axes.set_xticks(positions, [shorten(name) for name in names], rotation=90, fontsize=7)
    else:
        axes.set_xlabel("in the order of the record")
    return positions


def sectors(axes: Axes, ring: Geometry | None, label: bool = True) -> None:
    """Draw a line where every sector begins, with names where there is room."""
    if ring is None or axes.get_xlabel() != "s [m]":
        return
    begins = [place for place in ring.sectors_m if place is not None]
    for place in begins:
        axes.axvline(place, color=GREY, lw=0.4, ls=":", zorder=0)
    axes.set_xlim(0.0, ring.circumference_m)
    every = max(1, len(begins) // 15)
    if label and len(ring.sector_names) == len(begins):
        for place, name in list(zip(begins, ring.sector_names, strict=True))[::every]:
            axes.annotate(
                shorten(name, 8),
                (place, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(1, 1),
                textcoords="offset points",
                fontsize=6.5,
                color=GREY,
            )


def shorten(name: str, most: int = 22) -> str:
    """Make text for a picture: nothing but signs, no formula, not longer than there is room."""
    plain = "".join(sign for sign in name if sign.isprintable())
    short = plain if len(plain) <= most else f"{plain[: most - 1]}…"
    return short.replace("$", r"\$")
