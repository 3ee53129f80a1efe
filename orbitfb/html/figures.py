"""Figures of matplotlib inside a page, and their colours."""

import base64
import io
import warnings
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from orbitfb.html.page import text

BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#1d2329", "#8a949d"
"""Colours that people with any colour vision can tell apart (Okabe and Ito)."""

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


def shorten(name: str, most: int = 22) -> str:
    """Make text for a picture: nothing but signs, no formula, not longer than there is room."""
    plain = "".join(sign for sign in name if sign.isprintable())
    short = plain if len(plain) <= most else f"{plain[: most - 1]}…"
    return short.replace("$", r"\$")
