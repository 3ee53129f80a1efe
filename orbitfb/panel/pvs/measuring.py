"""The PVs of the measurement of the response: start, progress, abort."""

from orbitfb.measure.progress import Stage
from orbitfb.panel.pv import Kind, PanelPv
from orbitfb.panel.pvs.forms import choice_pv, count_pv, number_pv, text_pv


def measuring_pvs() -> tuple[PanelPv, ...]:
    """Give them all, names without prefix."""
    orders = (
        {"command": "measure", "action": "start"},
        {"command": "measure", "action": "start", "fresh": True},
        {"command": "measure", "action": "abort"},
    )
    return (
        choice_pv(
            "Measure-Cmd",
            "Measures the response while the loop is open, or aborts and restores the setpoints.",
            ("-", "start", "start anew", "abort"),
            *orders,
        ),
        PanelPv(
            "MeasureState-I",
            Kind.CHOICE,
            "Stage of the measurement of the response; FAILED is a MINOR alarm.",
            states=tuple(stage.value for stage in Stage),
            minor=(Stage.FAILED.value,),
        ),
        count_pv("MeasureDone-I", "Correctors that are measured."),
        count_pv("MeasureTotal-I", "Correctors to measure."),
        number_pv("MeasureShare-I", "Share of the orbits that are done.", "%", 1),
        number_pv("MeasureLeft-I", "Time that the measurement still takes.", "s", 0),
        text_pv("MeasureText-I", "Result of the last measurement, or what it does now."),
    )
