"""Bad configuration: each kind is refused with what, where and what to do."""

import ast
import re
import sys
from pathlib import Path

import pytest
from typer.main import get_command

import orbitfb.cli
from orbitfb.cli.app import app, main
from orbitfb.config.load import OPTIONS, load_config
from orbitfb.config.text import to_toml
from orbitfb.core.errors import ConfigError, OrbitFeedbackError, RingError

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
        "  --port: Input should be greater than or equal to 0, got -1 (key sim.port)",
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
    assert str(caught.value) == f"{file}: not UTF-8 text at byte 4; save it as UTF-8"


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
        "--rate: loop.rate_hz lies below loop, which is already set to 3, a plain value"
    )


def test_later_sources_win(tmp_path: Path):
    file = tmp_path / "orbitfb.toml"
    file.write_text('seed = 2\ndata_directory = "a"\n[loop]\nrate_hz = 20\nramp = 2.0\n')
    environment = {"ORBITFB_LOOP__RATE_HZ": "30", "ORBITFB_DATA_DIRECTORY": "b", "OTHER": "1"}
    config = load_config(file, {"loop.rate_hz": 40.0, "seed": None}, environment)
    assert (config.loop.rate_hz, config.loop.ramp, config.seed) == (40.0, 2.0, 2)
    assert config.data_directory == Path("b")


def test_paths_of_a_file_are_seen_from_it_and_others_from_the_working_directory(tmp_path: Path):
    (tmp_path / "ring").mkdir()
    file = tmp_path / "ring" / "orbitfb.toml"
    file.write_text(
        '\ufeffdata_directory = "data"\n[ring]\nplaces = "places.csv"\n'
        'response = "/measured/r.safetensors"\n[panel]\nrules = "../rules.toml"\n'
        '[observe.logs]\nfile = "its.log"\n',
        encoding="utf-8",
    )
    config = load_config(
        file, {"data_directory": "here"}, {"ORBITFB_RING__PARAMETERS": "ring.json"}
    )
    assert config.data_directory == Path("here")
    assert config.ring.places == tmp_path / "ring" / "places.csv"
    assert config.ring.parameters == Path("ring.json")
    assert config.ring.response == Path("/measured/r.safetensors")
    assert config.panel.rules == tmp_path / "ring" / ".." / "rules.toml"
    assert config.observe.logs.file == "its.log", (
        "no path of its own: one within the data directory"
    )
    assert load_config(file, environment={}).data_directory == tmp_path / "ring" / "data"


def test_an_option_that_sets_two_keys_is_told_once():
    with pytest.raises(ConfigError) as caught:
        load_config(None, {"loop.rate_hz": 0.0, "sim.rate_hz": 0.0}, {})
    assert str(caught.value).count("--rate: Input should be greater than 0, got 0.0") == 1


def test_every_key_that_an_option_sets_is_called_by_it():
    """Messages name what was typed: the table of options is that of the commands."""
    folder = Path(orbitfb.cli.__file__).parent
    trees = [ast.parse(path.read_text()) for path in folder.glob("*.py")]
    calls = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)]
    keys = {
        keyword.arg.replace("__", ".")
        for call in calls
        if isinstance(call.func, ast.Name) and call.func.id == "configure"
        for keyword in call.keywords
        if keyword.arg not in (None, "effects_file")
    }
    assert keys == set(OPTIONS)
    words = {option for command in walked(get_command(app)) for param in command.params
             for option in param.opts}  # fmt: skip
    assert set(OPTIONS.values()) <= words


def walked(command):
    yield command
    for inner in getattr(command, "commands", {}).values():
        yield from walked(inner)


@pytest.mark.parametrize(
    ("variable", "value", "form"),
    [
        ("LEARN__ENABLED", "1", "write true or false"),
        ("LEARN__ENABLED", "yes", "write true or false"),
        ("MASKS__BPMS", "PH1A_C02", 'write a list, as in ["A", "B"]'),
        ("EPICS__AUXILIARY", "DCCT", "write a table"),
    ],
)
def test_a_value_of_the_wrong_form_is_told_the_right_one(variable: str, value: str, form: str):
    with pytest.raises(ConfigError) as caught:
        load_config(environment={f"ORBITFB_{variable}": value})
    assert form in str(caught.value)


@pytest.mark.parametrize("changed", [False, True])
def test_what_is_shown_is_accepted_and_says_the_same(
    changed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    environment = {
        "ORBITFB_SEED": "7",
        "ORBITFB_RING__PLACES": 'a "quoted" \\ µ.csv',
        "ORBITFB_LOOP__TRIP_AFTER": "3.5",
        "ORBITFB_POLICY__SVD__REGULARISATION": "1e-300",
        "ORBITFB_EPICS__AUXILIARY": '{ "a b" = { pv = "X:{Y}", scale = -2.5e-3 } }',
        "ORBITFB_INTERLOCKS__CURRENT_MIN": "off",
        "ORBITFB_OBSERVE__ENABLED": "false",
        "ORBITFB_PLANT__DRIFT__PRESET": "paper",
        "ORBITFB_PLANT__DRIFT__TICKS": "100",
    }
    config = load_config(environment=environment if changed else {})
    file = Path("shown.toml")
    file.write_text(to_toml(config), encoding="utf-8")
    assert load_config(file, environment={}) == config


def test_every_refusal_is_of_the_family():
    assert issubclass(ConfigError, OrbitFeedbackError) and issubclass(RingError, OrbitFeedbackError)


def cli(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run the program to its end: exit code, output, what it says on standard error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["orbitfb", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
            sys.exit(0)
    told = capsys.readouterr()
    return int(end.value.code or 0), told.out, told.err


def test_command_line_tells_it_on_stderr_and_exits_with_2(tmp_path: Path, capsys):
    file = tmp_path / "bad.toml"
    file.write_text("[loop]\nrate_hz = -1.0\n")
    code, out, err = cli(capsys, "config", "check", file)
    assert (code, out) == (2, "")
    assert err == (
        "orbitfb: the configuration is refused:\n"
        f"  loop.rate_hz: Input should be greater than 0, got -1.0 ({file}, line 2)\n"
        "`orbitfb config show` prints every key with its value and meaning.\n"
    )


def test_command_line_accepts_what_it_shows(tmp_path: Path, capsys):
    file = tmp_path / "shown.toml"
    file.write_text(cli(capsys, "config", "show")[1])
    assert cli(capsys, "config", "check", file) == (0, f"{file}: good\n", "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[panel]\nenabled = true\nrules = "nowhere.toml"\n', "nowhere.toml"),
        ('[ring]\nresponse = "nowhere.safetensors"\n', "nowhere.safetensors"),
    ],
)
def test_the_check_opens_the_files_that_are_named(tmp_path: Path, capsys, text: str, words: str):
    file = tmp_path / "named.toml"
    file.write_text(text)
    code, out, err = cli(capsys, "config", "check", file)
    assert (code, out) == (2, "")
    assert words in err


def test_a_fast_feedback_whose_status_nobody_reads_is_refused():
    told = {"interlocks.fast_feedback_channel": "fofb"}
    with pytest.raises(ConfigError, match="has no channel of this name"):
        load_config(None, told, environment={})
