"""PVs of the panel: names, limits, and what a write asks of the service."""

import math

import numpy as np
import pytest

from orbitfb.core.errors import ControlError
from orbitfb.panel.channels import checked, printable
from orbitfb.panel.pv import Kind, request_of
from orbitfb.panel.pv_table import Extent, panel_pvs, writable_names
from orbitfb.panel.settings import PanelSettings

PVS = panel_pvs(PanelSettings(), Extent("xy", 6, 4))
BY_NAME = {pv.name: pv for pv in PVS}


def test_names_are_unique_and_fit_into_a_pv_name():
    assert len(BY_NAME) == len(PVS)
    longest = max(len(pv.name) for pv in PVS)
    assert longest + 30 <= 60  # EPICS records have 60 characters; the prefix has at most 30


def test_every_setpoint_has_a_readback_and_limits():
    wishes = [pv for pv in PVS if pv.name.endswith("-SP")]
    assert len(wishes) == 21
    for pv in wishes:
        shown = BY_NAME[pv.name.removesuffix("-SP") + "-RB"]
        assert pv.limits[0] < pv.limits[1] or pv.kind is Kind.TEXT
        assert (shown.kind, shown.length, shown.units) == (pv.kind, pv.length, pv.units)
        assert pv.writable and not shown.writable


def test_what_can_be_written_is_named_so():
    assert all(name.endswith(("-SP", "-Cmd")) for name in writable_names(PVS))
    assert all(pv.writable == pv.name.endswith(("-SP", "-Cmd")) for pv in PVS)


@pytest.mark.parametrize(
    ("name", "value", "request_"),
    [
        ("Command-Cmd", "close", {"command": "close"}),
        ("Command-Cmd", 0, None),
        ("Reset-Cmd", 1, {"command": "reset"}),
        ("Refit-Cmd", 1, {"command": "refit", "activate": False}),
        ("Refit-Cmd", 2, {"command": "refit", "activate": True}),
        ("RollBack-Cmd", "do", {"command": "activate", "policy": None}),
        ("Activate-Cmd", "svd-12", {"command": "activate", "policy": "svd-12"}),
        ("BumpPlace-SP", "P1,P2", {"command": "bump", "place": "P1,P2"}),
        ("CorrectCompute-Cmd", "active", {"command": "correct", "law": "active"}),
        ("CorrectApply-Cmd", "do", {"command": "correct-apply"}),
        ("Measure-Cmd", "start", {"command": "measure", "action": "start"}),
        ("Measure-Cmd", "start anew", {"command": "measure", "action": "start", "fresh": True}),
        ("Measure-Cmd", "abort", {"command": "measure", "action": "abort"}),
        ("Undo-Cmd", "do", {"command": "undo"}),
        ("GainY-SP", 0.25, {"command": "gain", "plane": "y", "value": 0.25}),
        ("GainX-SP", [1.0], {"command": "gain", "plane": "x", "value": 1.0}),
        ("Dither-SP", 2.0, {"command": "dither", "orbit_cost": pytest.approx(2e-6)}),
        ("Modes-SP", 3, {"command": "try", "singular_values": 3}),
        ("Lambda-SP", 1e-4, {"command": "try", "regularisation": 1e-4}),
        ("Apply-Cmd", "do", {"command": "apply"}),
        ("ReferenceSave-Cmd", "golden\0\0", {"command": "reference-save", "name": "golden"}),
        (
            "Reference-SP",
            np.full(6, 0.5),
            {"command": "reference", "values": pytest.approx([0.5e-3] * 6)},
        ),
        (
            "CorrectorEnable-SP",
            np.array([1, 0, 1, 1]),
            {"command": "enable-correctors", "enabled": [True, False, True, True]},
        ),
    ],
)
def test_what_a_write_asks_for(name: str, value: object, request_: object):
    pv = BY_NAME[name]
    assert request_of(pv, checked(pv, value)) == request_


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("GainX-SP", 1.0001, "GainX-SP: 1.0001 is not from 0 to 1"),
        ("GainX-SP", -0.1, "GainX-SP: -0.1 is not from 0 to 1"),
        ("GainX-SP", math.nan, "GainX-SP: nan is not from 0 to 1"),
        ("GainX-SP", math.inf, "GainX-SP: inf is not from 0 to 1"),
        ("GainX-SP", [0.5, 0.5], "GainX-SP takes 1 numbers, not 2"),
        ("Dither-SP", 20.1, "Dither-SP: 20.1 is not from 0 to 20 um"),
        ("Modes-SP", 0, "Modes-SP: 0 is not from 1 to 4"),
        ("Modes-SP", 5, "Modes-SP: 5 is not from 1 to 4"),
        ("Reference-SP", [0.0] * 5, "Reference-SP takes 6 numbers, not 5"),
        ("Reference-SP", [0.0] * 5 + [1.01], "element 5 of Reference-SP: 1.01 is not from -1 to 1"),
        ("Reference-SP", [0.0] * 5 + [math.nan], "element 5 of Reference-SP: nan is not"),
        ("BpmEnable-SP", [1, 1, 1, 1, 1, 2], "element 5 of BpmEnable-SP: 2 is not from 0 to 1"),
        ("Command-Cmd", "clsoe", "Command-Cmd has no choice 'clsoe'; it has -, open, shadow"),
        ("Command-Cmd", 5, "Command-Cmd has no choice 5"),
        ("Command-Cmd", -1, "Command-Cmd has no choice -1"),
        ("Activate-Cmd", "a\nb", "Activate-Cmd takes printable ASCII text only"),
    ],
)
def test_beyond_its_limits_a_write_is_refused(name: str, value: object, message: str):
    with pytest.raises(ControlError) as caught:
        checked(BY_NAME[name], value)
    assert str(caught.value).startswith(message)


def test_any_text_can_be_shown():
    assert printable("rms 5 µm − R̂ é") == "rms 5 um - R ?"
    assert len(printable("x" * 5000)) == 1000
    assert all(pv.length >= 1000 for pv in PVS if pv.kind is Kind.TEXT)
