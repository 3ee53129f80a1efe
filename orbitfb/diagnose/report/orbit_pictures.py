"""Pictures of the orbit: predictions, the loop, along the ring, in time, by mode."""

from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.result.blocks import ClosedLoop, Geometry, KStep
from orbitfb.diagnose.result.parts import Gap
from orbitfb.html.axis import Axis, known, values
from orbitfb.html.svg import BLUE, GREEN, GREY, INK, RED, Panel, along, picture

_SHARE = "nats a row"


def k_steps(steps: Sequence[KStep]) -> str:
    """Draw how the error of the prediction grows with its length."""
    ahead = [float(step.k) for step in steps]
    lines = (
        ("nominal model", [s.nominal_um for s in steps], BLUE, False),
        ("with the causes", [s.effect_um for s in steps], RED, False),
        ("noise and drift alone", [s.floor_um for s in steps], GREY, True),
    )
    x = Axis("rows ahead", ahead[0] / 1.2, ahead[-1] * 1.2, True, [(k, f"{k:g}") for k in ahead])
    panel = Panel(x, Axis.over("error, rms [µm]", *(one[1] for one in lines), zero=True))
    for label, heights, colour, dashed in lines:
        if known(heights):
            panel.line(ahead, heights, colour, label, dashed)
            if not dashed:
                panel.dots(ahead, heights, colour)
    said = "Error of a prediction from the logged setpoints, against the rows that it looks ahead."
    return picture(said, [panel])


def closed_loop(its: ClosedLoop) -> str:
    """Draw the orbit of the loop, measured and without the causes, and its spectrum."""
    rows = [("measured", its.measured_um, INK)]
    if its.without_um is not None:
        rows.append(("without", its.without_um, GREEN))
    ticks = [(float(place), row[0]) for place, row in enumerate(rows)]
    bars = Panel(
        Axis("", -0.7, len(rows) - 0.3, ticks=ticks),
        Axis.over("orbit error, rms [µm]", [row[1] for row in rows], zero=True),
        share=0.34,
    )
    for place, (_, height, colour) in enumerate(rows):
        bars.bars([place - 0.3], [place + 0.3], [height], colour)
    panels = [bars]
    if len(its.frequency_hz) > 1 and known(its.psd_measured):
        spectra = [
            ("measured", its.psd_measured, INK),
            ("without the causes", its.psd_without, GREEN),
        ]
        spectra = [one for one in spectra if len(one[1]) == len(its.frequency_hz)]
        lines = Panel(
            Axis.over("frequency [Hz]", its.frequency_hz, log=True),
            Axis.over("spectrum [µm²/Hz]", *(one[1] for one in spectra), log=True),
            share=0.66,
        )
        for label, spectrum, colour in spectra:
            lines.line(its.frequency_hz, spectrum, colour, label)
        panels.append(lines)
    said = (
        "Orbit error, measured, and as the same loop would hold it without the causes, with the "
        "same noise and drift."
    )
    return picture(said, panels)


def along_the_ring(gap: Gap, ring: Geometry | None) -> str:
    """Draw what the causes add to the error of a prediction at every BPM."""
    names, heights = list(gap.um_by_bpm), values(list(gap.um_by_bpm.values()))
    places, label = along(names, ring.bpms if ring else None)
    panel = Panel(Axis.over(label, places), Axis.over("rms [µm]", heights, zero=True), height=130)
    vertical = np.array([name.endswith(" (y)") for name in names])
    both = bool(vertical.any())
    for chosen, colour, plane in ((~vertical, BLUE, "x"), (vertical, GREEN, "y")):
        if chosen.any():
            panel.stems(places[chosen], heights[chosen], colour, plane if both else "")
    said = "What the causes add to the error of a prediction one row ahead, at every BPM."
    return picture(said, [panel])


def in_time(gap: Gap, onsets: Sequence[float]) -> str:
    """Draw the gap over time and over frequency."""
    windows, bands = gap.by_window, gap.by_band
    heights = [p.nats_per_tick for p in windows]
    lefts, rights = [p.start for p in windows], [p.stop for p in windows]
    when = Panel(
        Axis.over("time since the first reading [s]", lefts, rights),
        Axis.over(_SHARE, heights, zero=True),
        height=120,
        share=0.5,
    )
    when.bars(lefts, rights, heights, BLUE)
    for number, onset in enumerate(onsets):
        when.moment(onset, RED, "a cause begins" if number == 0 else "")
    told = [p.nats_per_tick for p in bands]
    stops = [(float(place), f"{p.stop or 0.0:.2g}") for place, p in enumerate(bands)]
    which = Panel(
        Axis("frequency, up to [Hz]", -0.7, len(bands) - 0.3, ticks=stops),
        Axis.over("", told, zero=True),
        height=120,
        share=0.5,
    )
    order = np.arange(len(bands), dtype=np.float64)
    which.bars(order - 0.45, order + 0.45, told, BLUE)
    said = "The gap in time and by frequency. Both divisions add up to the same total."
    return picture(said, [when, which])


def modes(by_mode: Sequence[float | None]) -> str:
    """Draw the gap by singular mode."""
    heights = values(by_mode)
    count = len(heights) - 1
    order = np.arange(1.0, count + 1)
    panel = Panel(
        Axis.over("singular mode of the response, strongest first", [0.0, 1.06 * count]),
        Axis.over(_SHARE, heights, zero=True),
        height=120,
    )
    panel.bars(order - 0.5, order + 0.5, heights[:-1], BLUE)
    panel.bars([1.02 * count], [1.05 * count], heights[-1:], GREY)
    said = (
        "The gap by shape of the orbit. Correctors move the strong modes most. The grey bar is "
        "the part that no mode reaches."
    )
    return picture(said, [panel])
