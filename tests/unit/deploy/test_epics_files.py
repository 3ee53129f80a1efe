"""The files of the control room: made from the table of PVs, sound, and consistent with it."""

import ctypes
import importlib.util
import ipaddress
import json
import shlex
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import pytest
from epics.ca import find_libca

from orbitfb.panel.access import read_access
from orbitfb.panel.pv import Kind
from orbitfb.panel.pv_table import Extent, panel_pvs, writable_names
from orbitfb.panel.settings import PanelSettings

EPICS = Path(__file__).parents[3] / "deploy/epics"
SCREENS = ("overview.bob", "expert.bob", "orbit_x.bob")
PVS = panel_pvs(PanelSettings(), Extent("x", 180, 180))
PREFIX = PanelSettings().prefix
WRITING = ("textentry", "combo", "action_button")
BOX = ("x", "y", "width", "height")


@pytest.fixture(scope="module")
def generator():
    spec = importlib.util.spec_from_file_location("generate_epics", EPICS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def widgets(name: str) -> list[ElementTree.Element]:
    return ElementTree.parse(EPICS / name).getroot().findall("widget")


def named(widget: ElementTree.Element) -> set[str]:
    """PVs of a widget, without the prefix."""
    found = [its.text or "" for tag in ("pv_name", "x_pv", "y_pv") for its in widget.iter(tag)]
    return {text.removeprefix("$(P)") for text in found if text and text != "$(pv_name)"}


def test_files_are_what_the_generator_writes(generator):
    for name, text in generator.files().items():
        assert (EPICS / name).read_text(encoding="utf-8") == text, (
            f"deploy/epics/{name} is behind the code: run python deploy/epics/generate.py"
        )


def test_another_site_gets_its_own_prefix_and_planes(generator, tmp_path: Path):
    config = tmp_path / "site.toml"
    config.write_text('[panel]\nprefix = "B1:"\n[ring]\nplanes = "xy"\n')
    files = generator.files(config)
    assert '"B1:GainY-SP"' in files["archiver.json"] and "SR:FB" not in "".join(files.values())
    assert "<P>B1:</P>" in files["overview.bob"] and "RmsY-I" in files["overview.bob"]
    assert "ErrorY-I" in files["orbit_y.bob"] and "ErrorX-I" not in files["orbit_y.bob"]
    assert "orbit_y.bob" in files["overview.bob"]


def test_every_pv_is_on_the_expert_screen_or_drawn_along_the_ring_and_no_other_on_any():
    names = {pv.name for pv in PVS if pv.kind is not Kind.NAMES}
    expert = set().union(*map(named, widgets("expert.bob")))
    along = set().union(*map(named, widgets("orbit_x.bob")))
    assert not expert & along and expert | along == names
    assert set().union(*map(named, widgets("overview.bob"))) < names
    assert {pv.along for pv in PVS} - {""} <= along


def test_vectors_are_archived_now_and_then_and_names_are_not():
    entries = {entry["pv"]: entry for entry in json.loads((EPICS / "archiver.json").read_text())}
    error = entries[PREFIX + "ErrorX-I"]
    assert (error["samplingmethod"], error["samplingperiod"]) == ("SCAN", "10.0")
    assert entries[PREFIX + "Reference-RB"]["samplingmethod"] == "MONITOR"
    assert PREFIX + "BpmNameX-I" not in entries


@pytest.mark.parametrize("name", SCREENS)
def test_what_is_written_can_be_written(name: str):
    writable = set(writable_names(PVS))
    for widget in widgets(name):
        if widget.get("type") in WRITING:
            assert named(widget) <= writable


@pytest.mark.parametrize("name", SCREENS)
def test_buttons_write_words_that_the_pv_knows(name: str):
    states = {pv.name: pv.states for pv in PVS}
    for action in (its for widget in widgets(name) for its in widget.iter("action")):
        if action.get("type") == "open_display":
            assert (EPICS / action.findtext("file")).is_file()
            continue
    for widget in widgets(name):
        for action in widget.iter("action"):
            if action.get("type") == "write_pv":
                [pv] = named(widget)
                assert action.findtext("value") in states[pv]


@pytest.mark.parametrize("name", SCREENS)
def test_widgets_lie_in_the_window_and_on_no_other(name: str):
    display = ElementTree.parse(EPICS / name).getroot()
    wide, high = int(display.findtext("width")), int(display.findtext("height"))
    boxes = [tuple(int(its.findtext(tag)) for tag in BOX) for its in widgets(name)]
    for left, top, width, height in boxes:
        assert left >= 0 and left + width <= wide and top >= 0 and top + height <= high
    for (x1, y1, w1, h1), (x2, y2, w2, h2) in combinations(boxes, 2):
        apart = x1 + w1 <= x2 or x2 + w2 <= x1 or y1 + h1 <= y2 or y2 + h2 <= y1
        assert apart, f"{(x1, y1, w1, h1)} lies on {(x2, y2, w2, h2)}"


def test_the_alarm_tree_names_pvs_that_can_be_alarms_and_says_what_to_do():
    root = ElementTree.parse(EPICS / "alarms.xml").getroot()
    its = {PREFIX + pv.name: pv for pv in PVS}
    entries = list(root.iter("pv"))
    named_ = {entry.get("name") for entry in entries}
    assert {PREFIX + pv.name for pv in PVS if pv.alarms} <= named_ <= set(its)
    for entry in entries:
        assert len(entry.findtext("description")) > 10
        assert len(entry.findtext("guidance/details")) > 40
        assert int(entry.findtext("delay")) > 0
    assert (EPICS / root.find("component/display").findtext("details")).is_file()


def test_the_archiver_list_is_as_the_appliance_takes_it():
    entries = json.loads((EPICS / "archiver.json").read_text())
    names = [entry["pv"] for entry in entries]
    assert len(set(names)) == len(names) > 40
    assert set(names) < {PREFIX + pv.name for pv in PVS}
    assert {entry["samplingmethod"] for entry in entries} == {"MONITOR", "SCAN"}
    assert all(float(entry["samplingperiod"]) >= 1.0 for entry in entries)


def test_the_access_rules_are_read_and_mean_what_they_say():
    access = read_access(EPICS / "access.toml", "127.0.0.1", writable_names(PVS))
    shift, outside = ("operator", "10.0.5.7"), ("operator", "10.0.6.7")
    assert access.may_write("Command-Cmd", *shift) and access.may_write("BpmEnable-SP", *shift)
    assert not access.may_write("GainX-SP", *shift)
    assert not access.may_write("Command-Cmd", *outside)
    assert access.may_write("GainX-SP", "physicist2", "10.0.5.7")
    assert access.may_write("GainX-SP", "anybody", "127.0.0.1")


def libcom() -> Path:
    [found] = Path(find_libca()).parent.glob("libCom*.so")
    return found


def test_the_rules_for_the_correctors_are_read_by_epics_base():
    from epicscorelibs.path import get_lib

    base = ctypes.CDLL(get_lib("Com"))
    assert base.asInitFile(str(EPICS / "correctors.acf").encode(), None) == 0
    wrong = EPICS / "access.toml"
    assert base.asInitFile(str(wrong).encode(), None) != 0


@pytest.mark.parametrize("name", ["service.env", "clients.env"])
def test_the_environment_is_one_that_libca_knows(name: str):
    lines = (EPICS / name).read_text().splitlines()
    words = [word for line in lines for word in shlex.split(line, comments=True)]
    variables = dict(word.split("=", 1) for word in words)
    known = libcom().read_bytes()
    for variable in variables:
        assert f"{variable}\0".encode() in known, f"{variable} is no variable of libca"
    assert variables["EPICS_CA_AUTO_ADDR_LIST"] == "NO"
    for address in variables["EPICS_CA_ADDR_LIST"].split():
        host, _, port = address.partition(":")
        assert ipaddress.ip_address(host).is_private
        assert not port or int(port) == PanelSettings().port
