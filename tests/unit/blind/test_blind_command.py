"""The command of the blind check: records, two engines, one result."""

import json
from pathlib import Path

import pytest

from benchmarks.blind import __main__ as command
from benchmarks.blind.workers import Answer


def wise(name: str) -> dict:
    """Engine that knows from the number of a record what it is of; see `fodo.generate`."""
    effect = ["", "corrector-gain", "bpm-gain", "corrector-lag"][int(name) % 10]
    return said("named", effect) if effect else {"state": "no_gap", "causes": []}


def said(state: str, effect: str) -> dict:
    return {"state": state, "causes": [{"effect": effect, "probability": 0.97}]}


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Engines that answer here, without processes."""

    def answers(tasks, jobs, longest):
        found = []
        for task in tasks:
            told = wise(task.record.stem) if "wise" in task.engine else said("named", "bpm-roll")
            found.append(Answer(told, 1.0, 0.5, 100.0))
        return found

    monkeypatch.setattr(command, "diagnose_all", answers)
    monkeypatch.setattr(command.engines, "load", lambda name: None)
    monkeypatch.setattr(command.engines, "fingerprint", lambda name: "1")


def test_two_engines_on_the_same_records(tmp_path: Path, stubs: None, capsys) -> None:
    told = ["--fodo", "10", "--first", "4", "--out", str(tmp_path), "--engine", "m:wise"]
    assert command.main([*told, "--engine", "m:foolish", "--least", "0.9"]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    wise_, foolish = (result["engines"][name] for name in ("m:wise", "m:foolish"))
    assert [row["right"] for row in wise_["records"]] == [True] * 4
    assert [row["right"] for row in foolish["records"]] == [False] * 4
    first = result["paired"][0]["outcomes"][0]
    assert (first["first"], first["second"], first["p_value"]) == (4, 0, 0.125)
    text = (tmp_path / "result.md").read_text()
    assert "| right, all records | 0 | 4 | 0 | 0 | 0.125 |" in text
    assert "| no gap | no_gap 1 of 1 |" in text
    assert "m:wise (A) beside m:foolish (B)" in capsys.readouterr().out


def test_an_earlier_result_is_held_against(tmp_path: Path, stubs: None) -> None:
    told = ["--fodo", "10", "--first", "4", "--out", str(tmp_path)]
    before = str(tmp_path / "before.json")
    assert command.main([*told, "--engine", "m:foolish", "--json", before]) == 0
    assert command.main([*told, "--engine", "m:wise", "--against", before]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["paired"][0]["second"] == f"m:foolish of {before}"
    assert command.main([*told, "--engine", "m:wise", "--against", str(tmp_path)]) == 2


def test_too_few_right_ones_fail(tmp_path: Path, stubs: None, capsys) -> None:
    told = ["--fodo", "10", "--first", "2", "--out", str(tmp_path), "--engine", "m:foolish"]
    assert command.main([*told, "--least", "0.5"]) == 1
    assert "right: 0.000 of the records" in capsys.readouterr().err


def test_an_absent_generator_is_left_out_with_the_reason(
    tmp_path: Path, stubs: None, capsys
) -> None:
    told = ["--fodo", "10", "--first", "2", "--out", str(tmp_path), "--engine", "m:wise"]
    assert command.main([*told, "--plant", str(tmp_path / "gone")]) == 0
    assert f"left out: --plant {tmp_path / 'gone'}: there is no" in capsys.readouterr().err
    assert command.main(["--out", str(tmp_path), "--plant", str(tmp_path / "gone")]) == 2


def test_left_out_effects_are_records_of_their_own(tmp_path: Path, stubs: None) -> None:
    """Those that can be seen: the one of seed 1 is five times what counts as medium."""
    told = ["--fodo", "0", "--first", "2", "--out", str(tmp_path), "--engine", "m:wise"]
    assert command.main([*told, "--leave-out"]) == 0
    rows = json.loads((tmp_path / "result.json").read_text())["engines"]["m:wise"]["records"]
    assert [row["kind"] for row in rows] == ["none", "single", "foreign"]
    assert rows[2]["misnamed"]


def test_an_engine_that_is_none_ends_with_words(tmp_path: Path, capsys) -> None:
    told = ["--fodo", "10", "--first", "1", "--out", str(tmp_path), "--engine", "nowhere:f"]
    assert command.main(told) == 2
    assert "--engine nowhere:f" in capsys.readouterr().err
