"""Bad inputs of commands: one message, at once, that names what was typed."""

import socket
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from orbitfb.cli.app import app, main
from orbitfb.core.errors import ConfigError, ControlError
from orbitfb.evaluate.campaign import run_tasks
from orbitfb.evaluate.pool.task import Task


def refused(*arguments):
    with pytest.raises(ConfigError) as caught:
        app([*map(str, arguments)], standalone_mode=False)
    return str(caught.value)


@pytest.mark.parametrize("command", ["kick", "campaign", "refit"])
def test_an_evaluation_that_could_not_be_written_is_not_begun(tmp_path, command):
    (tmp_path / "file").write_text("in the way")
    assert "--out" in refused("evaluate", command, "--out", tmp_path / "file" / "here")


@pytest.mark.parametrize(
    ("option", "value"), [("noise", "-1e-6"), ("ticks", "100"), ("seed", "-1"), ("drift", "wild")]
)
def test_a_campaign_refuses_points_that_no_evaluation_takes(tmp_path, option, value):
    said = refused("evaluate", "campaign", "--out", tmp_path / "out", f"--{option}={value}")
    assert said.startswith(f"--{option}: ")
    assert said.count("--") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value"), [("law", "none"), ("size", "nan"), ("rate", "0"), ("matrix-error", "-1")]
)
def test_the_kick_experiment_names_the_option_that_was_given(tmp_path, option, value):
    said = refused("evaluate", "kick", "--out", tmp_path / "out", f"--{option}={value}")
    assert said.startswith(f"--{option}: ")
    assert said.count("--") == 1


def test_a_command_that_there_is_not_is_told_without_a_service(tmp_path):
    with pytest.raises(ControlError, match=r"no command 'opne' \(did you mean open\?\)"):
        app(["command", "opne", "--data", str(tmp_path)], standalone_mode=False)


def test_a_place_that_is_nearly_sim_is_no_unknown_host(monkeypatch):
    monkeypatch.setattr("socket.gethostbyname", Mock(side_effect=OSError))
    assert "'simm' (did you mean sim?)" in refused("run", "--ioc", "simm", "--duration", 1)


def test_the_check_of_a_configuration_knows_the_names_that_may_be_masked(tmp_path):
    file = tmp_path / "masks.toml"
    file.write_text('[masks]\nbpms = ["PH1A_C31"]\n')
    assert "masks.bpms" in refused("config", "check", file)


def test_the_check_of_a_configuration_refuses_gains_that_no_ring_bears(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[policy.svd]\ngain = 1.8\nintegral_gain = 1.0\n")
    assert "policy.svd: unstable: near zero the orbit would grow" in refused(
        "config", "check", file
    )


@pytest.mark.parametrize("address", ["nonsense", "tcp://host", "tcp://127.0.0.1:99999"])
def test_what_is_no_address_of_a_scheduler_is_refused(monkeypatch, address):
    pytest.importorskip("distributed")
    monkeypatch.setattr("distributed.Client", lambda *_, **__: pytest.fail("asked Dask"))
    with pytest.raises(ConfigError, match="no address of a Dask scheduler"):
        run_tasks([Task("math:sqrt", {"x": 4.0})], scheduler=address)


def test_a_scheduler_that_does_not_answer_is_not_waited_for(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("distributed.Client", lambda *_, **__: pytest.fail("asked Dask"))

    def refuse(where, patience):
        raise ConnectionRefusedError(f"{where[0]} refused, {patience:g} s allowed")

    monkeypatch.setattr(socket, "create_connection", refuse)
    with pytest.raises(ConfigError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:8786"):
        run_tasks([Task("math:sqrt", {"x": 4.0})], scheduler="tcp://127.0.0.1:8786")


@pytest.mark.parametrize(
    "command", [("run", "--ioc", "sim"), ("ioc",), ("train", "modal"), ("evaluate", "kick")]
)
def test_a_file_of_effects_of_another_ring_is_named(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.toml").write_text(
        '[[effect]]\nid = "corrector-gain"\nnames = ["LX03/KICK2"]\nvalues = { gain = 0.3 }\n'
    )
    out = ("--out", "out") if command[0] == "evaluate" else ()
    said = refused(*command, "--effects", "theirs.toml", *out)
    assert said.startswith("--effects theirs.toml is not of this ring and cannot be simulated on")
    assert "no correctors called 'LX03/KICK2'" in said
    assert [path.name for path in tmp_path.iterdir()] == ["theirs.toml"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("arguments", [("config", "show"), ("config", "schema"), ("--version",)])
def test_an_output_without_room_is_told_in_words(arguments):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "orbitfb", *arguments], stdout=full, stderr=subprocess.PIPE,
            text=True, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "the output cannot be written (No space left on device)" in done.stderr


def test_too_little_memory_is_told_in_words(monkeypatch, capsys):
    def gorge():
        raise MemoryError

    monkeypatch.setattr("orbitfb.cli.app.app", gorge)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "orbitfb: there is not enough memory; raise the limit" in capsys.readouterr().err
