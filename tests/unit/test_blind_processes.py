"""A check that is asked to end leaves no process behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from orbitfb.cli import blind_processes
from orbitfb.core.errors import ConfigError

SLEEPER = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
with open(sys.argv[1], "w") as file:
    file.write(f"{os.getpid()} {child.pid}")
os.rename(sys.argv[1], sys.argv[1] + ".done")
time.sleep(60)
"""
CHECK = """
import sys
from orbitfb.cli.blind_processes import command, each, outliving_none

@outliving_none()
def check():
    each(lambda name: command(name, module="sleeper"), sys.argv[1:], 2, "done")

check()
"""


def alive(process: int) -> bool:
    """Whether a process runs; one that has ended and was not asked for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until(true, seconds: float = 20.0) -> bool:
    """Wait for something."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if true():
            return True
        time.sleep(0.05)
    return False


def test_what_a_check_started_ends_with_it(tmp_path):
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    names = [str(tmp_path / name) for name in ("one", "two", "three", "four")]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    root = Path(blind_processes.__file__).parents[2]
    check = subprocess.Popen([sys.executable, "-c", CHECK, *names], env=environment, cwd=root)
    told = [Path(f"{name}.done") for name in names[:2]]
    started: list[int] = []
    try:
        assert until(lambda: all(file.exists() for file in told))
        started = [int(word) for file in told for word in file.read_text().split()]
        assert len(started) == 4 and all(map(alive, started))
        check.send_signal(signal.SIGTERM)
        assert check.wait(20.0) == 128 + signal.SIGTERM
        assert until(lambda: not any(map(alive, started)))
        assert not any(Path(f"{name}.done").exists() for name in names[2:])
    finally:
        check.kill()
        check.wait()
        for process in filter(alive, started):
            os.kill(process, signal.SIGKILL)


def test_one_that_takes_too_long_is_ended_and_says_so(tmp_path, monkeypatch):
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    monkeypatch.setattr(blind_processes, "LONGEST", 3.0)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    ended = blind_processes.command(str(tmp_path / "one"), module="sleeper")
    assert (ended.code, ended.stderr) == (-1, "no answer within 3 s")
    started = [int(word) for word in (tmp_path / "one.done").read_text().split()]
    assert until(lambda: not any(map(alive, started)))


@pytest.mark.parametrize("code", [0, 3, 7])
def test_how_a_command_ends_is_told(tmp_path, monkeypatch, code):
    (tmp_path / "ender.py").write_text(f"import sys; print('told'); sys.exit({code})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    ended = blind_processes.command(module="ender")
    assert (ended.code, ended.stdout, ended.stderr) == (code, "told\n", "")


def test_cases_of_two_suites_are_not_mixed(tmp_path):
    blind_processes.claim(tmp_path, "quick", 1)
    blind_processes.claim(tmp_path, "quick", 1)  # to go on with them
    for suite, seed in (("quick", 9), ("fast", 1)):
        with pytest.raises(ConfigError, match=r"--suite quick --seed 1, .*use another --out"):
            blind_processes.claim(tmp_path, suite, seed)
    (tmp_path / "suite.json").unlink()
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "manifest.json").write_text('{"suite": "quick", "seed": 1}')
    with pytest.raises(ConfigError, match="--seed 1"):
        blind_processes.claim(tmp_path, "quick", 9)
    assert not (tmp_path / "suite.json").exists()
