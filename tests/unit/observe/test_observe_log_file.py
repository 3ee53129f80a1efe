"""The file of the log: whole lines or none, and none lost while the disk refuses."""

import logging
import os
import resource
import shutil
from pathlib import Path

import pytest

from orbitfb.observe.log_file import LogFile


@pytest.fixture
def log(tmp_path):
    (tmp_path / "d").mkdir()
    file = LogFile(tmp_path / "d" / "log", 10_000, 1)
    yield file
    file.close()


def say(log, *lines):
    for line in lines:
        log.emit(logging.LogRecord("a", logging.INFO, "", 0, line, None, None))


def lines(log):
    return Path(log.baseFilename).read_text().splitlines()


@pytest.fixture
def full():
    """No file may grow, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard if size is None else size, hard))

    yield fill
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("room", [0, 3])  # of 4 bytes, the second cuts the line
def test_lines_that_a_full_disk_refuses_wait(log, full, room, capsys):
    say(log, "one")
    full(4 + room)
    say(log, "two", "three")
    full(None)
    assert lines(log) == ["one"]
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and ("File too large" in said or "No space" in said)
    say(log, "four")
    assert lines(log) == ["one", "two", "three", "four"]


def test_a_directory_that_is_removed_comes_back_with_the_next_line(log):
    say(log, "one")
    shutil.rmtree(os.path.dirname(log.baseFilename))
    say(log, "two")
    assert lines(log) == ["two"]


def test_a_file_that_was_rotated_by_others_is_begun_anew(log):
    say(log, "one")
    os.rename(log.baseFilename, log.baseFilename + ".old")
    say(log, "two")
    assert lines(log) == ["two"]


def test_a_full_file_is_rotated(log):
    say(log, *("x" * 999 for _ in range(25)))
    assert len(lines(log)) == 5
    assert len(Path(log.baseFilename + ".1").read_text().splitlines()) == 10
