"""The same PVs on two servers: told, and never taken over without an operator."""

from pathlib import Path

import pytest
from service_process import Ioc, Service, orbitfb, wait_for

pytestmark = pytest.mark.system

QUIET = """
[learn]
enabled = false
[lease]
pv = ""
"""


def settings(directory: Path, *servers: Ioc) -> Path:
    config = directory / "c.toml"
    addresses = " ".join(f"127.0.0.1:{server.port}" for server in servers)
    config.write_text(f'{QUIET}[epics]\naddress_list = "{addresses}"\nreconnect_period = 0.5\n')
    return config


def places(tmp_path: Path) -> tuple[Path, Path]:
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    return one, other


def test_a_server_that_takes_over_the_pvs_holds_the_loop_until_it_is_closed(tmp_path: Path):
    here, there = places(tmp_path)
    with Ioc(here) as first, Ioc(there) as second:
        config = settings(tmp_path, first, second)
        second.kill()
        with Service(tmp_path / "data", "config", "--start", "closed", "--config", config) as run:
            run.wait_below(5.0)
            assert len(run.where["servers"]) == 1
            with Ioc(there, second.port):
                first.kill()
                told = "come from another server than before"
                held = run.wait_status("the reason", lambda its: told in its["reason"], 30.0)
                assert held["state"] == "HELD"
                later = run.wait_status(
                    "ticks", lambda its: its["ticks"] > held["ticks"] + 30, 30.0
                )
                assert (later["state"], told in later["reason"]) == ("HELD", True)
                assert any(told in line["problem"] for line in run.events("servers_of_pvs"))
                done = orbitfb("command", "close", "--data", run.data)
                assert done.returncode == 0, done.stderr
                run.wait_below(5.0)


@pytest.mark.nightly
def test_pvs_that_two_servers_have_are_told_at_start_and_by_the_doctor(tmp_path: Path):
    here, there = places(tmp_path)
    with Ioc(here) as first, Ioc(there) as second:
        config = settings(tmp_path, first, second)
        doctor = orbitfb("doctor", "--ioc", "config", "--config", config)
        assert "more than one server" in doctor.stdout
        with Service(tmp_path / "data", "config", "--start", "open", "--config", config) as run:
            wait_for("the news", lambda: run.events("servers_of_pvs"), 10.0)
            assert "more than one server" in run.events("servers_of_pvs")[0]["problem"]
