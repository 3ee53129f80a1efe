"""What a control room keeps about the panel beside its screens: alarm tree and list to archive."""

import json
from collections.abc import Sequence
from xml.etree import ElementTree as Xml

from orbitfb.panel.pv import VECTORS, Kind, PanelPv
from orbitfb.panel.screens import EXPERT, ORBIT, OVERVIEW, expert, orbit, overview, planes_of

_UNARCHIVED = ("PVs-I",)
_SLOW = ("Heartbeat-I", "Version-I")
VECTOR_PERIOD = 10.0
"""Time between two samples of a vector that changes at every update [s]: 20 vectors of 180 numbers
are 0.25 GB a day then."""

_GUIDANCE = {
    "State-I": (
        "Orbit feedback is HELD, TRIPPED or in FAULT",
        "Read Reason and LastTrip on the overview. HELD closes again by itself. TRIPPED: the "
        "setpoints stay; find the cause (orbitfb postmortem), press reset, then close. FAULT: "
        "read the log, start the service again.",
        10,
    ),
    "Heartbeat-I": (
        "Orbit feedback does not tick",
        "INVALID: the panel runs and the loop does not; disconnected: neither does. The setpoints "
        "stay. Look at the service (orbitfb health, systemctl status orbitfb).",
        10,
    ),
    "RfState-I": (
        "Orbit feedback leaves the RF frequency alone",
        "The orbit is still corrected, the energy is not. RfReason says why. Repair it, then "
        "write follow to Rf-Cmd, or leave if the frequency is to stay.",
        10,
    ),
    "HandOver-I": (
        "Orbit feedback does not hand its reference to the fast feedback",
        "The reference of the fast feedback is not what was put: somebody else sets it, or it does "
        "not take puts. It stays. HandOverReason names the BPM. Agree on who sets it, then close.",
        10,
    ),
    "BpmsInvalid-I": (
        "Orbit feedback leaves out BPMs",
        "They are disconnected, invalid, frozen or implausible. The orbit is corrected without "
        "them. The log names them (bpm_mask_changed). Repair them before there are too many.",
        60,
    ),
    "MeasureState-I": (
        "The measurement of the response failed",
        "The setpoints were put back where the machine answered. MeasureText says what went "
        "wrong, and which were not put back. The response in force is unchanged. Repair it, then "
        "measure again.",
        10,
    ),
}
"""Alarm: title, what to do, delay [s]."""
_PASSING = ("BpmsInvalid-I", "RfState-I", "MeasureState-I")
"""Alarms that hold up no beam: they need no acknowledgement and are not announced."""


def site_files(prefix: str, pvs: Sequence[PanelPv]) -> dict[str, str]:
    """Write every file by its name.

    Args:
        prefix: Of the panel's PVs.
        pvs: All PVs of the panel.
    """
    return {
        OVERVIEW: overview(prefix, pvs),
        EXPERT: expert(prefix, pvs),
        **{ORBIT.format(plane=p): orbit(prefix, pvs, p) for p in planes_of(pvs)},
        "alarms.xml": alarm_tree(prefix, pvs),
        "archiver.json": archiver_list(prefix, pvs),
    }


def alarm_tree(prefix: str, pvs: Sequence[PanelPv]) -> str:
    """Write the alarm tree, to be imported by the alarm server of Phoebus.

    Args:
        prefix: Of the panel's PVs.
        pvs: All PVs of the panel.
    """
    root = Xml.Element("config", name="Accelerator")
    tree = Xml.SubElement(root, "component", name="Orbit feedback")
    display = Xml.SubElement(tree, "display")
    Xml.SubElement(display, "title").text = "Overview"
    Xml.SubElement(display, "details").text = OVERVIEW
    for pv in pvs:
        if pv.name not in _GUIDANCE:
            continue
        title, details, delay = _GUIDANCE[pv.name]
        entry = Xml.SubElement(tree, "pv", name=prefix + pv.name)
        latching = pv.name not in _PASSING
        for name, text in (
            ("description", title),
            ("enabled", "true"),
            ("latching", str(latching).lower()),
            ("annunciating", str(latching).lower()),
            ("delay", str(delay)),
        ):
            Xml.SubElement(entry, name).text = text
        guidance = Xml.SubElement(entry, "guidance")
        Xml.SubElement(guidance, "title").text = "What to do"
        Xml.SubElement(guidance, "details").text = details
    Xml.indent(root)
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    return head + Xml.tostring(root, encoding="unicode") + "\n"


def archiver_list(prefix: str, pvs: Sequence[PanelPv]) -> str:
    """Write the list for the Archiver Appliance (`mgmt/bpl/archivePV`), one PV a line.

    Args:
        prefix: Of the panel's PVs.
        pvs: All PVs of the panel.
    """
    lines = [
        json.dumps(
            {"pv": prefix + pv.name, "samplingmethod": method, "samplingperiod": f"{period:.1f}"}
        )
        for pv in pvs
        if pv.name not in _UNARCHIVED
        and pv.kind is not Kind.NAMES
        and not (pv.writable and pv.kind is Kind.CHOICE)
        for method, period in (_sampling(pv),)
    ]
    return "[\n " + ",\n ".join(lines) + "\n]\n"


def _sampling(pv: PanelPv) -> tuple[str, float]:
    """Say how a PV is sampled, and how often [s]."""
    if pv.name in _SLOW:
        return "SCAN", 60.0
    if pv.kind in VECTORS and pv.name.endswith("-I"):
        return "SCAN", VECTOR_PERIOD
    return "MONITOR", 1.0
