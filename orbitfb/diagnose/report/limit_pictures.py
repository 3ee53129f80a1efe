"""Pictures of limits: what is left, against noise."""

import numpy as np
from scipy.stats import norm

from orbitfb.diagnose.result.blocks import Audit
from orbitfb.html.axis import Axis, known, values
from orbitfb.html.svg import BLUE, GREY, RED, Panel, picture


def audit(its: Audit) -> str:
    """Draw quantiles against the normal ones, and the correlation from row to row."""
    panels: list[Panel] = []
    if known(its.quantiles):
        panels.append(_quantiles(its))
    if known(its.autocorrelation):
        panels.append(_echo(its))
    said = (
        "Left: sorted errors of predictions against those of noise; noise lies on the line. Right: "
        "their correlation from row to row; noise stays within the dashed lines."
    )
    return picture(said, panels) if panels else ""


def _quantiles(its: Audit) -> Panel:
    found = np.sort(values(its.quantiles))
    wanted = norm.ppf((np.arange(len(found)) + 0.5) / len(found))
    panel = Panel(Axis.over("noise [σ]", wanted), Axis.over("errors [σ]", found, wanted), share=0.5)
    panel.line(wanted, wanted, GREY)
    panel.line(wanted, found, BLUE)
    return panel


def _echo(its: Audit) -> Panel:
    found = values(its.autocorrelation)
    limit = its.autocorrelation_limit or 0.0
    order = np.arange(1.0, len(found) + 1)
    panel = Panel(
        Axis("rows apart", 0.3, len(found) + 0.7, ticks=[(float(n), f"{n:.0f}") for n in order]),
        Axis.over("correlation [1]", found, [1.3 * limit, -1.3 * limit]),
        share=0.5,
    )
    panel.bars(order - 0.3, order + 0.3, found, BLUE)
    panel.level(limit, colour=RED)
    panel.level(-limit, colour=RED)
    panel.level(0.0, dashed=False)
    return panel
