"""Bad configuration, bad tables: each is refused with what, where and what to do."""

import csv
import io
import json
import re
import subprocess
import sys
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

from orbitfb.config import load_config, to_toml
from orbitfb.core.errors import ConfigError, OrbitFeedbackError, RingError
from orbitfb.physics.places import Ring

PLACES = (resources.files("orbitfb") / "data/places.csv").read_text(encoding="utf-8")
PARAMETERS = json.loads((resources.files("orbitfb") / "data/ring.json").read_text())

BAD_TOML = {
    "unknown section": (
        "\n[lop]\nrate_hz = 1.0\n",
        "lop: no such key (FILE, line 2); did you mean loop?",
    ),
    "unknown key": (
        "[loop]\n\nrate = 5.0\n",
        "loop.rate: no such key (FILE, line 3); did you mean rate_hz?",
    ),
    "unknown key, nothing like it": (
        "[ring]\nxyz = 1\n",
        "ring.xyz: no such key (FILE, line 2); known here: places, parameters, planes",
    ),
    "unknown key in a dotted line": (
        "plant.drift.tics = 3\n",
        "plant.drift.tics: no such key (FILE, line 1); did you mean ticks?",
    ),
    "unknown key in an inline table": (
        "\n\nloop = { rat = 3.0 }\n",
        "loop.rat: no such key (FILE, line 3)",
    ),
    "unknown key of a slow channel": (
        '[epics.auxiliary.current]\npv = "A"\nscal = 1.0\n',
        "epics.auxiliary.current.scal: no such key (FILE, line 3)",
    ),
    "missing key of a slow channel": (
        "[epics.auxiliary.current]\nscale = 1.0\n",
        "epics.auxiliary.current.pv: Field required, got {'scale': 1.0} (FILE, line 1)",
    ),
    "text for a number": (
        '[loop]\nrate_hz = "10"\n',
        "loop.rate_hz: Input should be a valid number, got '10' (FILE, line 2)",
    ),
    "truth for a number": (
        "[loop]\nrate_hz = true\n",
        "loop.rate_hz: Input should be a valid number, got True (FILE, line 2)",
    ),
    "number for a truth": (
        "[learn]\nenabled = 1\n",
        "learn.enabled: Input should be a valid boolean, got 1 (FILE, line 2)",
    ),
    "fraction for a count": (
        "[learn]\nevery = 2.5\n",
        "learn.every: Input should be a valid integer, got 2.5 (FILE, line 2)",
    ),
    "number for a path": (
        "data_directory = 3\n",
        "data_directory: Input should be a valid string, got 3 (FILE, line 1)",
    ),
    "value for a section": (
        "loop = 3\n",
        "loop: Input should be an object, got 3 (FILE, line 1)",
    ),
    "list for a number": ("seed = [1, 2]\n", "seed: Input should be a valid integer, got [1, 2]"),
    "negative rate": (
        "[loop]\nrate_hz = -10.0\n",
        "loop.rate_hz: Input should be greater than 0, got -10.0 (FILE, line 2)",
    ),
    "above the range": (
        "[sim]\nport = 70000\n",
        "sim.port: Input should be less than or equal to 65535, got 70000 (FILE, line 2)",
    ),
    "a port that libca does not take": (
        "[sim]\nport = 5000\n",
        "clients that use libca take 5064 for any port below 5001",
    ),
    "a server port that libca does not take": (
        "[epics]\nserver_port = 80\n",
        "epics.server_port: Input should be greater than or equal to 5001, got 80 (FILE, line 2)",
    ),
    "nan": (
        "[interlocks]\ndistortion_rms = nan\n",
        "interlocks.distortion_rms: Input should be a finite number, got nan (FILE, line 2)",
    ),
    "inf": (
        "[limits]\nsetpoint = inf\n",
        "limits.setpoint: Input should be a finite number, got inf (FILE, line 2)",
    ),
    "planes": (
        '[ring]\nplanes = "yx"\n',
        "ring.planes: Input should be 'x', 'y' or 'xy', got 'yx' (FILE, line 2)",
    ),
    "preset": (
        '[plant.drift]\npreset = "papr"\n',
        "plant.drift.preset: Input should be 'none', 'paper', 'mild' or 'strong', got 'papr'",
    ),
    "not TOML": ("seed = 1\n[loop\n", "FILE: is not TOML: "),
    "a key twice": (
        "seed = 1\nseed = 2\n",
        "FILE: is not TOML: Cannot overwrite a value (at line 2",
    ),
}


@pytest.mark.parametrize("name", BAD_TOML)
def test_bad_file(name: str, tmp_path: Path):
    text, message = BAD_TOML[name]
    file = tmp_path / "orbitfb.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(file, environment={})
    assert message.replace("FILE", str(file)) in str(caught.value)


def test_what_is_not_toml_is_told_with_its_line(tmp_path: Path):
    file = tmp_path / "orbitfb.toml"
    file.write_text("seed = 1\n[loop\n")
    with pytest.raises(ConfigError, match=r"at line 2"):
        load_config(file, environment={})


def test_everything_wrong_is_told_at_once(tmp_path: Path):
    file = tmp_path / "orbitfb.toml"
    file.write_text('seed = -1\n[loop]\nrat = 3\n[ring]\nplanes = "z"\n')
    with pytest.raises(ConfigError) as caught:
        load_config(file, {"sim.port": -1}, {"ORBITFB_LEARN__EVERY": "no"})
    text = str(caught.value)
    for line in (
        f"  seed: Input should be greater than or equal to 0, got -1 ({file}, line 1)",
        f"  loop.rat: no such key ({file}, line 3); did you mean rate_hz?",
        f"  ring.planes: Input should be 'x', 'y' or 'xy', got 'z' ({file}, line 5)",
        "  sim.port: Input should be greater than or equal to 0, got -1 (command line)",
        "  learn.every: Input should be a valid integer, got 'no' "
        "(environment variable ORBITFB_LEARN__EVERY)",
    ):
        assert line in text.splitlines()
    assert "orbitfb config show" in text.splitlines()[-1]


def test_file_that_is_not_there(tmp_path: Path):
    file = tmp_path / "nowhere.toml"
    with pytest.raises(ConfigError) as caught:
        load_config(file, environment={})
    assert str(caught.value) == (
        f"{file}: cannot be read (No such file or directory); name a TOML file with --config"
    )


def test_directory_for_a_file(tmp_path: Path):
    with pytest.raises(ConfigError, match=re.escape(f"{tmp_path}: cannot be read (Is a directory")):
        load_config(tmp_path, environment={})


def test_file_that_is_not_utf8(tmp_path: Path):
    file = tmp_path / "orbitfb.toml"
    file.write_bytes("# Grün\nseed = 1\n".encode("latin-1"))
    with pytest.raises(ConfigError) as caught:
        load_config(file, environment={})
    assert str(caught.value) == f"{file}: is not UTF-8 text (byte 4)"


BAD_ENVIRONMENT = {
    "unknown section": (
        {"ORBITFB_LOPP__RATE_HZ": "3"},
        "lopp: no such key (environment variable ORBITFB_LOPP__RATE_HZ); did you mean loop?",
    ),
    "unknown key": (
        {"ORBITFB_LOOP__RATE": "3"},
        "loop.rate: no such key (environment variable ORBITFB_LOOP__RATE); did you mean rate_hz?",
    ),
    "one underscore": (
        {"ORBITFB_LOOP_RATE_HZ": "3"},
        "loop_rate_hz: no such key (environment variable ORBITFB_LOOP_RATE_HZ)",
    ),
    "ill-typed": (
        {"ORBITFB_LOOP__RATE_HZ": "fast"},
        "loop.rate_hz: Input should be a valid number, got 'fast' "
        "(environment variable ORBITFB_LOOP__RATE_HZ)",
    ),
    "out of range": (
        {"ORBITFB_SEED": "-3"},
        "seed: Input should be greater than or equal to 0, got -3 "
        "(environment variable ORBITFB_SEED)",
    ),
    "below a plain value": (
        {"ORBITFB_SEED": "3", "ORBITFB_SEED__LOW": "1"},
        "environment variable ORBITFB_SEED__LOW: seed.low lies below seed, which is already set "
        "to 3, a plain value",
    ),
    "no name": ({"ORBITFB_": "3"}, "no such key (environment variable ORBITFB_)"),
}


@pytest.mark.parametrize("name", BAD_ENVIRONMENT)
def test_bad_environment(name: str):
    environment, message = BAD_ENVIRONMENT[name]
    with pytest.raises(ConfigError) as caught:
        load_config(environment=environment)
    assert message in str(caught.value)


def test_option_below_a_plain_value_of_the_file(tmp_path: Path):
    file = tmp_path / "orbitfb.toml"
    file.write_text("loop = 3\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file, {"loop.rate_hz": 5.0}, {})
    assert str(caught.value) == (
        "command line: loop.rate_hz lies below loop, which is already set to 3, a plain value"
    )


def test_later_sources_win(tmp_path: Path):
    file = tmp_path / "orbitfb.toml"
    file.write_text('seed = 2\ndata_directory = "a"\n[loop]\nrate_hz = 20\nramp = 2.0\n')
    environment = {"ORBITFB_LOOP__RATE_HZ": "30", "ORBITFB_DATA_DIRECTORY": "b", "OTHER": "1"}
    config = load_config(file, {"loop.rate_hz": 40.0, "seed": None}, environment)
    assert (config.loop.rate_hz, config.loop.ramp, config.seed) == (40.0, 2.0, 2)
    assert config.data_directory == Path("b")


@pytest.mark.parametrize("changed", [False, True])
def test_what_is_shown_is_accepted_and_says_the_same(changed: bool, tmp_path: Path):
    environment = {
        "ORBITFB_SEED": "7",
        "ORBITFB_RING__PLACES": 'a "quoted" \\ µ.csv',
        "ORBITFB_LOOP__TRIP_AFTER": "3.5",
        "ORBITFB_POLICY__REGULARISATION": "1e-300",
        "ORBITFB_EPICS__AUXILIARY": '{ "a b" = { pv = "X:{Y}", scale = -2.5e-3 } }',
        "ORBITFB_OBSERVE__ENABLED": "false",
        "ORBITFB_PLANT__DRIFT__PRESET": "paper",
        "ORBITFB_PLANT__DRIFT__TICKS": "100",
    }
    config = load_config(environment=environment if changed else {})
    file = tmp_path / "shown.toml"
    file.write_text(to_toml(config), encoding="utf-8")
    assert load_config(file, environment={}) == config


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
        "restore the missing rows, or correct `counts`",
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
        put(BPM_1, "pv_x", ""),
        f"FILE, line {BPM_1 + 1}, column pv_x: '' is no PV, but a BPM needs one; give the PV",
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


def test_every_refusal_is_of_the_family():
    assert issubclass(ConfigError, OrbitFeedbackError) and issubclass(RingError, OrbitFeedbackError)


def cli(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "orbitfb", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_command_line_tells_it_on_stderr_and_exits_with_2(tmp_path: Path):
    file = tmp_path / "bad.toml"
    file.write_text("[loop]\nrate_hz = -1.0\n")
    done = cli("config", "check", file)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "orbitfb: the configuration is refused:\n"
        f"  loop.rate_hz: Input should be greater than 0, got -1.0 ({file}, line 2)\n"
        "`orbitfb config show` prints every key with its value and meaning.\n"
    )


def test_command_line_checks_the_table_too(tmp_path: Path):
    table, _ = places(tmp_path, copy("name", (BPM_1, BPM_2)))
    file = tmp_path / "orbitfb.toml"
    file.write_text(f'[ring]\nplaces = "{table}"\n')
    done = cli("config", "check", file)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"orbitfb: {table}, line {BPM_2 + 1}, column name: ")
    assert "Traceback" not in done.stderr


def test_command_line_accepts_what_it_shows(tmp_path: Path):
    file = tmp_path / "shown.toml"
    file.write_text(cli("config", "show").stdout)
    done = cli("config", "check", file)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{file}: good\n", "")
