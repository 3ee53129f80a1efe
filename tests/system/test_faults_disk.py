"""The disk is full, the directory is gone, a clock is set: the loop goes on and says so."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from service_process import Service, transitions, wait_for

from orbitfb.control.client import ask

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    directory = tmp_path_factory.mktemp("disk")
    (directory / "c.toml").write_text(
        "[history.archive]\nretry_interval = 0.2\n"
        "[loop]\nhold_after = 100.0\n[epics]\nstale_after = 10.0\n"  # a busy computer stalls
    )
    options = ("--rate", 20, "--start", "closed", "--config", directory / "c.toml")
    with Service(directory / "data", "sim", *options) as running:
        running.wait_below(1.0)
        yield running


def room(service: Service, size: int) -> None:
    """Let no file of the service grow beyond a size, as a full disk does."""
    process = psutil.Process(service.popen.pid)
    process.rlimit(psutil.RLIMIT_FSIZE, (size, psutil.RLIM_INFINITY))


def ticks_on(service: Service, count: int) -> None:
    """Wait for more ticks, of a loop that stays CLOSED."""
    status = service.status()
    first, closed = status["ticks"], status["state_entries"]["CLOSED"]
    status = service.wait_status("ticks", lambda its: its["ticks"] > first + count, 20.0)
    assert (status["state"], status["state_entries"]["CLOSED"]) == ("CLOSED", closed)


def failing(service: Service) -> bool:
    return service.metric("orbitfb_archive_failing") == 1.0


def test_a_full_disk_costs_nothing_but_what_waits_too_long(service: Service):
    before = service.status()["ticks"]
    room(service, 1)
    wait_for("trouble", lambda: failing(service))
    ticks_on(service, 40)
    assert service.metric("orbitfb_archive_rows_waiting") >= 40
    ask(service.data, {"command": "open"})  # nor does the log take it
    ask(service.data, {"command": "close"})
    room(service, psutil.RLIM_INFINITY)
    wait_for("recovery", lambda: not failing(service))
    wait_for("line", lambda: service.events("archive_resumed"))
    failed = service.events("archive_failed")[0]  # others are about what cannot be compressed
    assert "File too large" in failed["problem"] and "make room" in failed["problem"]
    assert service.events("archive_resumed")[0]["lost"] == 0
    assert service.events("log_resumed")[0]["lost"] == 0
    told = [event["state"] for event in service.events("loop_state_changed")[-2:]]
    assert told == ["OPEN", "CLOSED"]
    wait_for("ticks", lambda: service.metric("orbitfb_archive_rows_waiting") < 20)
    archived = transitions(service.data)
    assert set(range(before, before + 40)) <= set(archived.tick.tolist())


def test_a_data_directory_that_is_gone_is_made_again(service: Service):
    shutil.rmtree(service.data / "archive")
    (service.data / "orbitfb.log.jsonl").unlink()
    wait_for("archive", lambda: list((service.data / "archive").glob("*.h5")))
    ticks_on(service, 20)
    wait_for("line", lambda: service.events("archive_resumed"))
    failed = service.events("archive_failed")  # of the segment, and of one that waited
    assert any("was removed" in event["problem"] for event in failed)
    wait_for("ticks", lambda: len(transitions(service.data)) > 10)
    assert Path(service.data / "orbitfb.log.jsonl").exists()
