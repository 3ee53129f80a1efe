"""Pictures of maps: BPM by frequency, corrector by lag, effect by effect."""

import numpy as np
from matplotlib.axes import Axes

from orbitfb.diagnose.answer_blocks import HeatMap
from orbitfb.diagnose.report.draw import picture, shorten, values

_MOST_ROWS = 16
_MOST_COLUMNS = 12


def heat(its: HeatMap) -> str:
    """Draw a map; grey where it is not resolved."""
    grid = np.array([values(row) for row in its.values])
    height = min(6.5, max(2.4, 0.14 * len(grid) + 1.2))
    return picture(
        f"{its.title}; grey: not resolved.",
        (8.5, height),
        lambda figure: paint_heat(figure.subplots(), its, grid),
    )


def paint_heat(axes: Axes, its: HeatMap, grid: np.ndarray) -> None:
    """Draw a map on axes, with a bar of its colours."""
    axes.set_facecolor("#c9ced3")
    largest = float(np.nanmax(np.abs(grid))) if np.isfinite(grid).any() else 1.0
    columns = values(its.columns)
    extent = (-0.5, grid.shape[1] - 0.5, len(grid) - 0.5, -0.5)
    named = len(columns) == grid.shape[1] > 1
    even = named and np.allclose(np.diff(columns), columns[1] - columns[0])
    if even:
        half = (columns[-1] - columns[0]) / (len(columns) - 1) / 2
        extent = (columns[0] - half, columns[-1] + half, len(grid) - 0.5, -0.5)
    elif named:  # such as octaves: each has the same room, and its own number
        every = max(1, len(columns) // _MOST_COLUMNS)
        axes.set_xticks(range(len(columns))[::every], [f"{v:.3g}" for v in columns[::every]])
    image = axes.imshow(
        grid,
        aspect="auto",
        extent=extent,
        cmap="RdBu_r" if its.signed else "cividis",
        vmin=-largest if its.signed else None,
        vmax=largest if its.signed else None,
    )
    if its.row_names:
        rows = range(len(its.row_names))[:: -(-len(its.row_names) // _MOST_ROWS)]
        axes.set_yticks(rows, [shorten(its.row_names[row]) for row in rows])
    if 0 < len(its.column_names) <= _MOST_ROWS:
        names = [shorten(name) for name in its.column_names]
        axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axes.set_xlabel(shorten(its.column_label, 48))
    axes.set_ylabel(shorten(its.row_label, 48))
    bar = axes.get_figure().colorbar(image, ax=axes)  # pyright: ignore[reportOptionalMemberAccess]
    bar.set_label(shorten(its.unit, 24))
