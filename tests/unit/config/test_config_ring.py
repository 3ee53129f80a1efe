"""Bad tables and parameters of the ring that a configuration names: what, where, what to do."""

import csv
import io
import json
import re
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

from orbitfb.cli.app import app
from orbitfb.config.load import load_config
from orbitfb.core.errors import RingError
from orbitfb.physics.places import Ring

PLACES = (resources.files("orbitfb") / "data/places.csv").read_text(encoding="utf-8")
PARAMETERS = json.loads((resources.files("orbitfb") / "data/ring.json").read_text())

Change = Callable[[list[list[str]]], object]


def places(tmp_path: Path, change: Change) -> tuple[Path, list[list[str]]]:
    """Write a changed places table; row 0 is the header, line n is row n − 1."""
    rows = list(csv.reader(io.StringIO(PLACES)))
    change(rows)
    file = tmp_path / "places.csv"
    with file.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return file, rows


def column(name: str) -> int:
    return PLACES.splitlines()[0].split(",").index(name)


def put(row: int, name: str, value: str) -> Change:
    def change(rows: list[list[str]]) -> None:
        rows[row][column(name)] = value

    return change


def both(one: Change, other: Change) -> Change:
    def change(rows: list[list[str]]) -> None:
        one(rows)
        other(rows)

    return change


def first(kind: str, count: int = 1) -> list[int]:
    rows = list(csv.reader(io.StringIO(PLACES)))
    return [i for i, row in enumerate(rows) if row[column("kind")] == kind][:count]


def drop_column(name: str) -> Change:
    def change(rows: list[list[str]]) -> None:
        for row in rows:
            del row[column(name)]

    return change


def copy(name: str, rows: tuple[int, int]) -> Change:
    def change(table: list[list[str]]) -> None:
        table[rows[1]][column(name)] = table[rows[0]][column(name)]

    return change


def swap_rows(rows: list[list[str]]) -> None:
    rows[5], rows[6] = rows[6], rows[5]


BPM_1, BPM_2 = first("BPM", 2)
COR_1 = first("COR")[0]
QUAD = first("QUAD")[0]
BAD_PLACES: dict[str, tuple[Change, str]] = {
    "missing column": (
        drop_column("beta_x_m"),
        "FILE, line 1: column beta_x_m is missing from the header",
    ),
    "duplicate name": (
        copy("name", (BPM_1, BPM_2)),
        f"FILE, line {BPM_2 + 1}, column name: 'PH1A_C30' stands already on line {BPM_1 + 1}, "
        "column name; make it unique",
    ),
    "duplicate PV": (
        copy("pv_x", (BPM_1, COR_1)),
        f"FILE, line {COR_1 + 1}, column pv_x: 'SR:C30-BI{{BPM:1}}Pos:X-I' stands already on line "
        f"{BPM_1 + 1}, column pv_x; make it unique",
    ),
    "wrong count": (
        lambda rows: rows.pop(BPM_1),
        "FILE: 179 places of kind BPM, but orbitfb/data/ring.json says that the ring has 180; "
        "restore the missing rows, or give the ring its own file of parameters with its "
        "`counts` (ring.parameters)",
    ),
    "not a number": (
        put(QUAD, "beta_y_m", "1,5"),
        f"FILE, line {QUAD + 1}, column beta_y_m: '1,5' is not a number; write a decimal number",
    ),
    "nan": (
        put(QUAD, "eta_x_m", "nan"),
        f"FILE, line {QUAD + 1}, column eta_x_m: 'nan' is not finite; write a finite number",
    ),
    "infinite": (
        put(QUAD, "s_m", "1e999"),
        f"FILE, line {QUAD + 1}, column s_m: '1e999' is not finite",
    ),
    "not in ring order": (swap_rows, "FILE, line 7, column s_m: "),
    "beta of zero": (
        put(BPM_1, "beta_x_m", "0.0"),
        f"FILE, line {BPM_1 + 1}, column beta_x_m: '0.0' is not above 0; a beta function is",
    ),
    "negative beta": (
        put(BPM_1, "beta_y_m", "-3"),
        f"FILE, line {BPM_1 + 1}, column beta_y_m: '-3' is not above 0",
    ),
    "unknown kind": (
        put(BPM_1, "kind", "BMP"),
        f"FILE, line {BPM_1 + 1}, column kind: 'BMP' is no kind of place; use one of BPM, COR",
    ),
    "BPM without a PV": (
        both(put(BPM_1, "pv_x", ""), put(BPM_1, "pv_y", "")),
        f"FILE, line {BPM_1 + 1}, column pv_x: '' is no PV, nor is that of pv_y, but a BPM needs "
        "one; give one or both",
    ),
    "corrector that cannot kick": (
        put(COR_1, "cal_x_rad_per_A", "0"),
        f"FILE, line {COR_1 + 1}, column cal_x_rad_per_A: '0' is a corrector that cannot kick",
    ),
    "beyond the circumference": (
        lambda rows: put(len(rows) - 1, "s_m", "99999")(rows),
        "'99999' is outside 0 … ",
    ),
    "short row": (
        lambda rows: rows[3].pop(),
        "FILE, line 4: ",
    ),
    "empty file": (
        lambda rows: rows.clear(),
        "FILE, line 1: column name, kind, s_m, ",
    ),
    "only a header": (
        lambda rows: rows.__delitem__(slice(1, None)),
        "FILE: no place of kind BPM, so there are no readings; add at least one row",
    ),
}


@pytest.mark.parametrize("name", BAD_PLACES)
def test_bad_places(name: str, tmp_path: Path):
    change, message = BAD_PLACES[name]
    file, _ = places(tmp_path, change)
    config = load_config(options={"ring.places": file}, environment={})
    with pytest.raises(RingError) as caught:
        config.ring.load()
    assert message.replace("FILE", str(file)) in str(caught.value)


def test_places_that_are_not_there(tmp_path: Path):
    with pytest.raises(RingError) as caught:
        Ring.load(tmp_path / "places.csv")
    assert str(caught.value) == (
        f"{tmp_path}/places.csv: cannot be read (No such file or directory); correct the path in "
        "the configuration"
    )


def test_places_that_are_no_text(tmp_path: Path):
    file = tmp_path / "places.csv"
    file.write_bytes(PLACES.encode()[:10] + b"\xff")
    with pytest.raises(RingError, match=r"not UTF-8 text at byte 10; save it as UTF-8"):
        Ring.load(file)


BAD_PARAMETERS = {
    "missing key": (
        {k: v for k, v in PARAMETERS.items() if k != "nu_x"},
        "  nu_x = ",
        "Field required",
    ),
    "unknown key": (PARAMETERS | {"nu_z": 1.0}, "  nu_z = 1.0: ", "Extra inputs are not permitted"),
    "text for a number": (PARAMETERS | {"nu_y": "many"}, "  nu_y = 'many': ", "valid number"),
    "negative length": (
        PARAMETERS | {"circumference_m": -1.0},
        "  circumference_m = -1.0: ",
        "greater than 0",
    ),
    "resonance": (PARAMETERS | {"nu_x": 33.5}, "nu_x = 33.5 is an integer or half-integer", ""),
    "no compaction": (PARAMETERS | {"alpha_c": 0.0}, "alpha_c = 0 makes the dispersion", ""),
    "no object": ([1, 2], "(document)", ""),
}


@pytest.mark.parametrize("name", BAD_PARAMETERS)
def test_bad_parameters(name: str, tmp_path: Path):
    content, key, problem = BAD_PARAMETERS[name]
    file = tmp_path / "ring.json"
    file.write_text(json.dumps(content))
    config = load_config(options={"ring.parameters": file}, environment={})
    with pytest.raises(RingError) as caught:
        config.ring.load()
    text = str(caught.value)
    assert text.startswith(f"{file}: ") and key in text and problem in text


def test_parameters_that_are_no_json(tmp_path: Path):
    file = tmp_path / "ring.json"
    file.write_text('{"nu_x": 1.0,\n "nu_y" 2.0}')
    with pytest.raises(RingError, match=re.escape(f"{file}, line 2: not JSON")):
        Ring.load(parameters=file)


def test_command_line_checks_the_table_too(tmp_path: Path):
    table, _ = places(tmp_path, copy("name", (BPM_1, BPM_2)))
    file = tmp_path / "orbitfb.toml"
    file.write_text(f'[ring]\nplaces = "{table}"\n')
    with pytest.raises(RingError) as told:
        app(["config", "check", str(file)], standalone_mode=False)
    assert str(told.value).startswith(f"{table}, line {BPM_2 + 1}, column name: ")
