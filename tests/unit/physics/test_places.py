"""The places table and the ring file: what they give, and how each fault is refused."""

import json
from importlib import resources

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orbitfb.core.errors import RingError
from orbitfb.physics.parameters import parse_parameters
from orbitfb.physics.places import Ring
from orbitfb.physics.table import COLUMNS, parse_places

TEXT = (resources.files("orbitfb") / "data" / "places.csv").read_text()
RING = json.loads((resources.files("orbitfb") / "data" / "ring.json").read_text())
LINES = TEXT.splitlines()
HEADER = LINES[0].split(",")
LINE_OF = {kind: next(i for i, x in enumerate(LINES) if f",{kind}," in x) for kind in
           ("BPM", "COR", "QUAD", "SEXT")}  # fmt: skip


def with_cell(kind, column, value):
    """The default table with one cell changed: its text and the line, counted from 1."""
    lines = LINES.copy()
    cells = lines[LINE_OF[kind]].split(",")
    cells[HEADER.index(column)] = value
    lines[LINE_OF[kind]] = ",".join(cells)
    return "\n".join(lines), LINE_OF[kind] + 1


def refusal(text):
    with pytest.raises(RingError) as caught:
        parse_places(text, "ring.csv", 791.958)
    return str(caught.value)


def test_the_default_ring_has_the_stated_places(ring):
    counts = [len(ring.places(kind)) for kind in ("BPM", "COR", "QUAD", "SEXT")]
    assert counts == [180, 180, 300, 270]
    assert ring.rf_frequency == pytest.approx(499.68e6, rel=1e-4)


def test_channels_are_in_ring_order_x_first(ring):
    both = ring.channels("xy")
    assert both.bpms[:180] == both.bpms[180:] == ring.channels("y").bpms
    assert both.orbit_pvs[0] == "SR:C30-BI{BPM:1}Pos:X-I"
    assert both.orbit_pvs[180] == "SR:C30-BI{BPM:1}Pos:Y-I"
    assert both.setpoint_pvs[0] == "SR:C30-MG{PS:CH1A}I:Sp1-SP"
    assert both.setpoint_pvs[180] == "SR:C30-MG{PS:CH1A}I:Sp2-SP"
    assert both.readback_pvs[180] == "SR:C30-MG{PS:CH1A}I:Ps2DCCT1-I"
    assert both.orbit_pvs == ring.channels("x").orbit_pvs + ring.channels("y").orbit_pvs


@pytest.mark.parametrize("column", COLUMNS)
def test_a_missing_column_is_named(column):
    text = TEXT.replace(f",{column},", ",other,", 1).replace("name,kind", "name,kind", 1)
    if column == "name":
        text = TEXT.replace("name,", "other,", 1)
    if column == "rb_y":
        text = TEXT.replace(",rb_y", ",other", 1)
    message = refusal(text)
    assert message.startswith(f"ring.csv, line 1: column {column} is missing")
    assert message.endswith("add it")


def test_a_cell_of_a_plane_that_the_device_is_not_in_is_refused():
    text, _ = with_cell("COR", "pv_y", "")
    told = refusal(text)
    assert "column cal_y_rad_per_A: " in told and "is of a plane without a PV (pv_y)" in told


def test_a_setpoint_that_is_its_own_readback_has_none():
    row = next(line for line in LINES if ",COR," in line)
    cells, names = row.split(","), LINES[0].split(",")
    at = {name: names.index(name) for name in ("pv_x", "rb_x")}
    cells[at["rb_x"]] = cells[at["pv_x"]]
    table = parse_places(TEXT.replace(row, ",".join(cells), 1), "ring.csv", 791.958)
    index = table.name.index(cells[0])
    assert table.readback[0][index] == "" and table.readback[1][index]


def test_a_device_in_no_plane_is_refused(tmp_path):
    row = next(line for line in LINES if ",BPM," in line)
    cells = row.split(",")
    names = LINES[0].split(",")
    for column in ("pv_x", "pv_y"):
        cells[names.index(column)] = ""
    told = refusal(TEXT.replace(row, ",".join(cells), 1))
    assert "pv_x: '' is no PV, nor is that of pv_y, but a BPM needs one; give one or both" in told


@pytest.mark.parametrize(
    ("kind", "column", "value", "problem"),
    [
        ("BPM", "kind", "BMP", "is no kind of place; use one of BPM, COR, QUAD, SEXT"),
        ("BPM", "name", "", "is empty"),
        ("BPM", "name", LINES[1].split(",")[0], "stands already on line 2, column name"),
        ("BPM", "pv_x", "SR:C30-BI{BPM:2}Pos:X-I", "stands already on line"),
        ("BPM", "pv_y", "SR:C30-BI{BPM:1}Pos:X-I", "stands already on line 3, column pv_x"),
        ("BPM", "s_m", "five", "is not a number"),
        ("BPM", "s_m", "", "is not a number"),
        ("BPM", "eta_x_m", "nan", "is not finite"),
        ("BPM", "beta_x_m", "inf", "is not finite"),
        ("BPM", "beta_y_m", "0", "is not above 0"),
        ("BPM", "beta_x_m", "-3", "is not above 0"),
        ("BPM", "s_m", "4.0", "is less than '4.75000' on line 2"),
        ("BPM", "s_m", "900", "is outside 0 … 791.958 m"),
        ("BPM", "mu_x_2pi", "0.01", "is less than '0.035"),
        ("QUAD", "strength", "strong", "is not a number"),
        ("SEXT", "strength", "", "is not a number"),
        ("COR", "cal_x_rad_per_A", "", "is not a number"),
        ("COR", "cal_y_rad_per_A", "0", "is a corrector that cannot kick"),
    ],
)
def test_a_wrong_cell_is_named_with_line_column_and_value(kind, column, value, problem):
    text, line = with_cell(kind, column, value)
    message = refusal(text)
    assert f"column {column}: " in message or column == "name"
    assert problem in message
    assert message.startswith(f"ring.csv, line {line}") or "stands already" in problem
    assert ";" in message  # … and what to do


def test_a_row_of_another_length_is_refused():
    lines = LINES.copy()
    lines[7] += ",extra"
    assert refusal("\n".join(lines)).startswith("ring.csv, line 8: 17 cells under 16 columns")


@pytest.mark.parametrize("kind", ["BPM", "COR"])
def test_a_table_without_a_kind_that_the_loop_needs_is_refused(kind):
    lines = [line for line in LINES if f",{kind}," not in line]
    assert f"no place of kind {kind}" in refusal("\n".join(lines))


@pytest.mark.parametrize("text", ["", "\n", "name,kind\n"])
def test_an_empty_table_is_refused(text):
    assert "is missing from the header" in refusal(text)


@pytest.mark.parametrize("kind", ["BPM", "COR", "QUAD", "SEXT"])
def test_a_wrong_count_is_refused(tmp_path, kind):
    lines = LINES.copy()
    del lines[LINE_OF[kind]]
    path = tmp_path / "places.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(RingError, match=rf"places.csv: \d+ places of kind {kind}, but .*ring.json"):
        Ring.load(places=path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(RingError, match=r"nowhere.csv: cannot be read .*; correct the path"):
        Ring.load(places=tmp_path / "nowhere.csv")


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "places.csv"
    path.write_bytes(b"name,kind\xff\xfe")
    with pytest.raises(RingError, match="not UTF-8 text at byte 9"):
        Ring.load(places=path)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"nu_x": 33.0}, r"nu_x = 33.0 is an integer or half-integer resonance"),
        ({"nu_y": 16.5}, r"nu_y = 16.5 is an integer or half-integer resonance"),
        ({"nu_x": "high"}, r"nu_x = 'high'"),
        ({"circumference_m": -1}, r"circumference_m = -1"),
        ({"alpha_c": 0.0}, r"alpha_c = 0 makes the dispersion term infinite"),
        ({"nu_z": 0.01}, r"nu_z = 0.01: Extra inputs"),
        ({"counts": {"BMP": 180}}, r"counts.BMP"),
    ],
)
def test_a_wrong_ring_parameter_is_named(change, problem):
    with pytest.raises(RingError, match=problem):
        parse_parameters(json.dumps(RING | change), "ring.json")


def test_a_missing_ring_parameter_is_named():
    with pytest.raises(RingError, match="nu_x"):
        parse_parameters(json.dumps({k: v for k, v in RING.items() if k != "nu_x"}), "ring.json")


def test_broken_json_names_its_line():
    with pytest.raises(RingError, match=r"ring.json, line 2: not JSON"):
        parse_parameters('{\n"nu_x": }', "ring.json")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    kind=st.sampled_from(["BPM", "COR", "QUAD", "SEXT"]),
    column=st.sampled_from(COLUMNS),
    value=st.text(st.characters(exclude_characters='",\r\n', categories=["L", "N", "P", "S"])),
)
def test_whatever_stands_in_a_cell_is_read_or_refused_by_a_ring_error(kind, column, value):
    lines = LINES[:40]
    cells = lines[LINE_OF[kind]].split(",")
    cells[HEADER.index(column)] = value
    lines[LINE_OF[kind]] = ",".join(cells)
    try:
        table = parse_places("\n".join(lines), "ring.csv", 791.958)
    except RingError as error:
        assert "ring.csv, line" in str(error)
    else:
        comment = lines[LINE_OF[kind]].startswith(("#", "%"))
        assert len(table.name) == (38 if comment else 39)


@pytest.mark.parametrize(
    "saved",
    [
        lambda text: "\ufeff" + text,
        lambda text: "# of the lattice of May\n% and later\n" + text,
        lambda text: "".join(f"{line},\n" for line in text.splitlines()) + ",,,,\n",
        lambda text: text.replace(",", ";"),
    ],
    ids=["byte order mark", "comments", "trailing commas", "semicolons"],
)
def test_a_table_as_spreadsheets_save_it(tmp_path, saved):
    path = tmp_path / "places.csv"
    path.write_text(saved(TEXT), encoding="utf-8")
    parameters = json.loads((resources.files("orbitfb") / "data" / "ring.json").read_text())
    (tmp_path / "ring.json").write_text("\ufeff" + json.dumps(parameters), encoding="utf-8")
    assert Ring.load(path, tmp_path / "ring.json").channels("x") == Ring.load().channels("x")


def test_the_unit_of_each_bpm_may_stand_in_a_column_of_its_own(tmp_path):
    lines = [f"{LINES[0]},unit"]
    units = iter(["um", "nm", ""])
    lines += [f"{line},{next(units, 'm') if ',BPM,' in line else ''}" for line in LINES[1:]]
    (tmp_path / "places.csv").write_text("\n".join(lines))
    channels = Ring.load(tmp_path / "places.csv").channels("xy")
    n = len(channels.bpms) // 2
    assert channels.bpm_units[:4] == ("um", "nm", "", "m")
    assert channels.bpm_units[n:] == channels.bpm_units[:n]
    assert Ring.load().channels("x").bpm_units == ()
    bad = "\n".join(lines).replace(",um", ",inch", 1)
    assert "column unit: 'inch' is no unit of a BPM; use one of m, mm, um, nm" in refusal(bad)


def test_the_default_ring_is_one_and_nobody_can_write_to_it():
    ring = Ring.load()
    assert Ring.load() is ring
    for name in ("s", "beta", "phase", "dispersion", "strength", "calibration"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(ring.table, name)[...] = 0.0
