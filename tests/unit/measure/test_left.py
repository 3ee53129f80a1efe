"""What a killed measurement left astray is told, and a damaged record of it in words."""

import re

import pytest
from measured_ring import CHANNELS, Bench
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError, MeasurementError
from orbitfb.measure.journal import Journal
from orbitfb.measure.left import DIRECTORY, left_astray

WHERE = "10.1.2.3:15064"


def told(tmp_path, where=WHERE, away=True, at=WHERE):
    bench = Bench(tmp_path)
    base = bench.machine.setpoints()
    if away:
        moved = base.copy()
        moved[[3, 4]] += 0.2
        bench.machine.write(moved)
    Journal(tmp_path / DIRECTORY, CHANNELS, at).mark([3, 4, 5], base, 1.7e9)
    return left_astray(tmp_path, bench.machine, where, "env", 1e-3)


def test_setpoints_astray_are_told_in_a_line_with_the_command(tmp_path):
    line = told(tmp_path)
    assert "\n" not in line and "2 setpoints astray" in line and "2023-11-14" in line
    assert CHANNELS.setpoint_pvs[3] in line
    assert f"`orbitfb measure-response --ioc env --data {tmp_path} --restore`" in line


def test_those_of_another_ring_are_told_with_its_address(tmp_path):
    line = told(tmp_path, at="10.9.9.9:5064")
    assert "up to 3 setpoints at 10.9.9.9:5064" in line
    assert f"--ioc 10.9.9.9:5064 --data {tmp_path} --restore --live`" in line


def test_nothing_is_said_where_nothing_is_astray(tmp_path):
    assert told(tmp_path, away=False) == ""
    assert left_astray(tmp_path / "other", Bench(tmp_path / "b").machine, WHERE, "env", 1e-3) == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[: len(text) // 2], r"it is no whole JSON \(line \d+, column \d+\)"),
        (lambda text: "", "it is no whole JSON"),
        (lambda text: "[]", "something else"),
        (lambda text: text.replace('"where"', '"were"'), "`where` is missing"),
        (lambda text: text.replace("1700000000.0", '"much"'), "`time` has a wrong value"),
        (lambda text: text.replace(CHANNELS.setpoint_pvs[5], "").replace(',\n  ""', ""), "2 PVs"),
    ],
)
def test_a_damaged_record_is_told_in_words_and_does_not_stop_the_loop(tmp_path, change, words):
    told(tmp_path)
    path = tmp_path / DIRECTORY / "moved.json"
    path.write_text(change(path.read_text()))
    journal = Journal(tmp_path / DIRECTORY, CHANNELS, WHERE)
    with pytest.raises(MeasurementError) as caught:
        journal.moved()
    message = str(caught.value)
    assert re.search(words, message), message
    assert str(path) in message and "by hand" in message and "remove the file" in message
    assert "pydantic" not in message and "input_value" not in message
    line = left_astray(tmp_path, Bench(tmp_path / "b").machine, WHERE, "env", 1e-3)
    assert message in line


def test_to_restore_and_to_leave_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["measure-response", "--ioc", "127.0.0.1:1", "--restore", "--leave"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code != 0
    assert isinstance(result.exception, ConfigError)
    assert "give one of the two" in str(result.exception)
    assert list(tmp_path.iterdir()) == []
