"""Files of the data directory: this user's alone, never through a link, whole or not there."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from orbitfb.app.commands.autosave import Reference, write_whole
from orbitfb.core.files.state import (
    AS_USUAL,
    create,
    make_directory,
    open_to_append,
    replace_file,
)
from orbitfb.observe.log_file import LogFile


@pytest.fixture(params=[0o000, 0o022])
def umask(request: pytest.FixtureRequest) -> Iterator[None]:
    before = os.umask(request.param)
    yield
    os.umask(before)


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


@pytest.mark.usefixtures("umask")
def test_they_are_of_this_user_alone_whatever_the_umask(tmp_path: Path):
    deep = tmp_path / "a" / "b"
    make_directory(deep)
    replace_file(deep / "state", b"1")
    open_to_append(deep / "log").close()
    assert {mode(deep), mode(deep.parent)} == {0o700}
    assert {mode(deep / "state"), mode(deep / "log")} == {0o600}


def test_what_the_user_wants_elsewhere_is_as_the_umask_says(tmp_path: Path):
    before = os.umask(0o022)
    try:
        replace_file(tmp_path / "export", b"1", AS_USUAL)
    finally:
        os.umask(before)
    assert mode(tmp_path / "export") == 0o644


def test_a_directory_that_is_there_stays_as_it_is(tmp_path: Path):
    tmp_path.chmod(0o750)
    make_directory(tmp_path)
    assert mode(tmp_path) == 0o750
    (tmp_path / "file").touch()
    for wrong in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(OSError):
            make_directory(wrong)


def test_a_link_where_a_part_is_to_be_written_is_not_followed(tmp_path: Path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / ".operator.json.part").symlink_to(victim)
    write_whole(tmp_path / "operator.json", Reference(bpms=("A:x",), position=(0.0,)))
    assert victim.read_text() == "mine"
    assert '"A:x"' in (tmp_path / "operator.json").read_text()
    assert not (tmp_path / ".operator.json.part").exists()


def test_a_link_in_the_place_of_a_file_is_replaced(tmp_path: Path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "state").symlink_to(victim)
    replace_file(tmp_path / "state", b"ours")
    assert victim.read_text() == "mine" and (tmp_path / "state").read_bytes() == b"ours"
    with create(tmp_path / "new") as file:
        file.write(b"1")
    assert (tmp_path / "new").read_bytes() == b"1"


def test_a_log_that_is_a_link_is_refused(tmp_path: Path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "log").symlink_to(victim)
    with pytest.raises(OSError, match="it is a link, and links are not followed"):
        LogFile(tmp_path / "log", 1000, 1)
    assert victim.read_text() == "mine"


def test_what_cannot_be_written_leaves_the_old_and_nothing_besides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    replace_file(tmp_path / "state", b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(tmp_path / "state", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["state"]
    assert (tmp_path / "state").read_bytes() == b"old"
