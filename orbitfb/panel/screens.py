"""The screens of the panel: for the shift, of every PV, and the vectors of each plane."""

from collections.abc import Sequence

from orbitfb.panel.pv import VECTORS, Kind, PanelPv
from orbitfb.panel.pv_table import STATES, UNKNOWN_STATE
from orbitfb.panel.screen import Colour, Screen

OVERVIEW = "overview.bob"
EXPERT = "expert.bob"
ORBIT = "orbit_{plane}.bob"
"""The screen of the vectors of a plane."""

_STATE_COLOURS: dict[str, Colour] = {
    UNKNOWN_STATE: (160, 160, 160),
    "OPEN": (200, 200, 200),
    "SHADOW": (120, 170, 220),
    "CLOSED": (60, 180, 75),
    "HELD": (240, 190, 40),
    "TRIPPED": (215, 50, 40),
    "FAULT": (160, 30, 160),
}
_MARGIN, _ROW, _TALL = 10, 30, 60


def overview(prefix: str, pvs: Sequence[PanelPv]) -> str:
    """Write the screen for the shift: how the loop is, and the four commands of every day.

    Args:
        prefix: Of the panel's PVs.
        pvs: All PVs of the panel.
    """
    its = {pv.name: pv for pv in pvs}
    rms = [pv for pv in pvs if pv.name.startswith("Rms")]
    screen = Screen("Orbit feedback", prefix, 900, 700)
    screen.label("Orbit feedback", (_MARGIN, 10, 300, 35), bold=True, size=24.0)
    screen.lamp(its["State-I"], (_MARGIN, 55, 200, 60), {s: _STATE_COLOURS[s] for s in STATES})
    for number, word in enumerate(("close", "open", "shadow")):
        screen.button(word, (230 + number * 110, 65, 100, 40), its["Command-Cmd"], word)
    screen.button("reset", (230 + 3 * 110, 65, 100, 40), its["Reset-Cmd"], "do")
    screen.way_to("expert", (780, 65, 100, 40), EXPERT)
    for number, plane in enumerate(planes_of(pvs)):
        box = (780 - number * 110, 15, 100, 40)
        screen.way_to(f"orbit {plane}", box, ORBIT.format(plane=plane))
    lines = ("Reason-I", "LastTrip-I", "LogLine-I", "GapText-I", "Policy-I", "LastRefit-I")
    fast = (("HandOver-I", 150, 130), ("HandOverReason-I", 290, 590))
    top = 130
    for name in lines:
        tall = _ROW if name == "Policy-I" else 50
        screen.label(_title(its[name]), (_MARGIN, top, 130, tall))
        screen.value(its[name], (150, top, 730, tall - 4))
        top += tall
    screen.label(_title(its["HandOver-I"]), (_MARGIN, top, 130, _ROW))
    for name, left, wide in fast:
        screen.value(its[name], (left, top, wide, _ROW - 4))
    top += _ROW
    figures = (*(pv.name for pv in rms), "BpmsInvalid-I", "Missed-I", "Heartbeat-I")
    for number, name in enumerate(figures):
        left = _MARGIN + number * 175
        screen.label(_title(its[name]), (left, top + 5, 170, 22))
        screen.value(its[name], (left, top + 27, 165, 40), size=22.0)
    screen.course(rms, (_MARGIN, top + 75, 880, 690 - top - 75), "rms orbit error [um]")
    return screen.text()


def expert(prefix: str, pvs: Sequence[PanelPv]) -> str:
    """Write the screen with every PV of the panel.

    Args:
        prefix: Of the panel's PVs.
        pvs: All PVs of the panel.
    """
    screen = Screen("Orbit feedback, expert", prefix, 1500, 1060)
    screen.label("Orbit feedback, expert", (_MARGIN, 10, 400, 35), bold=True, size=24.0)
    screen.way_to("overview", (1380, 10, 110, 35), OVERVIEW)
    plain = (Kind.TEXT, *VECTORS)
    shown = [pv for pv in pvs if pv.name.endswith("-I") and pv.kind not in plain]
    texts = [pv for pv in pvs if pv.name.endswith("-I") and pv.kind is Kind.TEXT]
    wishes = [pv for pv in pvs if pv.name.endswith("-SP")]
    orders = [pv for pv in pvs if pv.name.endswith("-Cmd")]
    top = _heading(screen, "Figures", _MARGIN)
    for pv in shown:
        screen.label(_title(pv), (_MARGIN, top, 130, 22))
        screen.value(pv, (145, top, 150, 22))
        top += 26
    top = _heading(screen, "Commands", _MARGIN, top + 10)
    for pv in orders:
        screen.label(_title(pv), (_MARGIN, top, 130, 24))
        screen.entry(pv, (145, top, 150, 24))
        top += 28
    top = _heading(screen, "Texts", 320)
    for pv in texts:
        screen.label(_title(pv), (320, top, 130, _TALL))
        screen.value(pv, (455, top, 400, _TALL - 4))
        top += _TALL
    top = _heading(screen, "Wanted, in force", 880)
    back = {pv.name: pv for pv in pvs}
    for pv in wishes:
        force = back[pv.name.removesuffix("-SP") + "-RB"]
        if pv.kind in VECTORS:
            screen.vector((pv, force), (880, top, 610, 190), pv.name.removesuffix("-SP"))
            top += 200
            continue
        screen.label(_title(pv), (880, top, 130, 24))
        screen.entry(pv, (1020, top, 150, 24))
        screen.value(force, (1180, top, 150, 24))
        top += 30
    return screen.text()


def orbit(prefix: str, pvs: Sequence[PanelPv], plane: str) -> str:
    """Write the screen with the vectors of one plane, along the ring.

    Args:
        prefix: Of the panel's PVs.
        pvs: All PVs of the panel.
        plane: x or y.
    """
    its = {pv.name: pv for pv in pvs}
    screen = Screen(f"Orbit feedback, plane {plane}", prefix, 1500, 1060)
    screen.label(f"Orbit feedback, plane {plane}", (_MARGIN, 10, 400, 35), bold=True, size=24.0)
    screen.way_to("overview", (1380, 10, 110, 35), OVERVIEW)
    for number, (names, title) in enumerate(_PLOTS):
        shown = [its[f"{name}{plane.upper()}-I"] for name in names]
        left, top = number % 2 * 745, 55 + number // 2 * 250
        screen.vector(shown, (_MARGIN + left, top, 735, 245), title)
    return screen.text()


_PLOTS = (
    (("Orbit", "Reference"), "orbit and reference"),
    (("Setpoint",), "setpoints"),
    (("Error",), "orbit error"),
    (("Room",), "room to the limits"),
    (("Computed", "Applied", "Shadow", "Preview"), "change of the last tick, and by hand"),
    (("BpmUsed", "CorrectorUsed"), "devices in use"),
    (("SingularValue",), "singular values"),
    (("ModeGain",), "part of each mode that a tick corrects"),
)
"""Vectors of a plane that are drawn together, and the title of the plot."""


def planes_of(pvs: Sequence[PanelPv]) -> list[str]:
    """Name the planes that a panel has the vectors of.

    Args:
        pvs: All PVs of the panel.
    """
    names = {pv.name for pv in pvs}
    return [plane for plane in "xy" if f"Orbit{plane.upper()}-I" in names]


def _heading(screen: Screen, words: str, left: int, top: int = 60) -> int:
    screen.label(words, (left, top, 280, 26), bold=True, size=16.0)
    return top + 32


def _title(pv: PanelPv) -> str:
    return pv.name.rpartition("-")[0]
