"""Two controllers of one machine, of other users or hosts: one writes. And none by accident."""

import os
import signal
from contextlib import ExitStack
from pathlib import Path

import pytest
from ioc_clients import run_client
from service_process import Ioc, Service, orbitfb, refused, wait_for

from orbitfb.app.setup.lease import take_lease
from orbitfb.app.setup.production_guard import check_live
from orbitfb.app.setup.startup import find_ring
from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError, OwnershipError

pytestmark = pytest.mark.system

LEASE = "SR:FB{Lease:X}Owner-SP"


def holder(port: int) -> str:
    return run_client(
        port,
        f"""
        import json, os
        import epics
        print(json.dumps(epics.caget({LEASE!r}, timeout=5.0)), flush=True)
        os._exit(0)
        """,
    )


def test_one_of_two_controllers_writes_and_a_stale_lease_is_taken_over(
    ioc: Ioc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The second is of a user whose file locks are others, as on another host."""
    here, there = os.environ["XDG_RUNTIME_DIR"], tmp_path / "elsewhere"
    there.mkdir(mode=0o700)
    where, config = f"127.0.0.1:{ioc.port}", tmp_path / "config.toml"
    config.write_text("[lease]\ntime = 4.0\n")
    with Service(tmp_path / "first", where, "--live", "--config", config) as first:
        wait_for("line", lambda: "live: the loop is OPEN and writes nothing" in first.out, 5.0)
        first.wait_state("OPEN")
        assert orbitfb("command", "close", "--data", first.data).returncode == 0
        owner = holder(ioc.port).rpartition(":")[0]
        assert f":{first.popen.pid}:" in owner
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(there))
        told = refused("run", "--ioc", where, "--config", config, "--data", tmp_path / "second")
        assert told.startswith(f"the machine is under the control of {owner} (host:process:token)")
        first.popen.send_signal(signal.SIGSTOP)  # its process stands still, as after a swap storm
        options = ("--start", "closed", "--config", config)
        with Service(tmp_path / "second", where, *options) as second:
            [taken] = second.events("stale_lease_taken_over")
            assert taken["before"] == owner
            second.wait_state("CLOSED")
            monkeypatch.setenv("XDG_RUNTIME_DIR", here)
            first.popen.send_signal(signal.SIGCONT)
            wait_for("loss", lambda: first.events("lease_lost"), 10.0)
            first.wait_state("OPEN")
            told = refused("command", "close", "--data", first.data)
            assert told.startswith("close refused: the lease of the machine was taken by")
            monkeypatch.setenv("XDG_RUNTIME_DIR", str(there))
            assert second.status()["state"] == "CLOSED"
            second.stop()
        assert holder(ioc.port) == ""  # given back


@pytest.mark.timing
def test_two_controllers_without_a_lease_see_each_other(
    ioc: Ioc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The machine serves none; the second is of a user whose file locks are others."""
    there = tmp_path / "elsewhere"
    there.mkdir(mode=0o700)
    where, config = f"127.0.0.1:{ioc.port}", tmp_path / "config.toml"
    config.write_text('[lease]\npv = "NO:SUCH{PV}"\nwait = 0.2\n')
    options = ("--start", "closed", "--config", config)
    with Service(tmp_path / "first", where, *options) as first:
        first.wait_state("CLOSED")
        with monkeypatch.context() as context:
            context.setenv("XDG_RUNTIME_DIR", str(there))
            with Service(tmp_path / "second", where, *options) as second:
                second.wait_state("TRIPPED")
                status = second.status()
                assert "as a second controller does" in status["reason"]
                second.stop()
        first.wait_state("CLOSED")
        assert first.status()["state_entries"]["TRIPPED"] == 0


def test_a_required_lease_that_is_not_there(ioc: Ioc):
    lease = {"lease.pv": "NO:SUCH{PV}", "lease.required": True, "lease.wait": 0.2}
    config = load_config(None, lease)
    epics = find_ring(config, f"127.0.0.1:{ioc.port}")
    with ExitStack() as stack, pytest.raises(OwnershipError) as caught:
        take_lease(config, epics, lambda _: None, stack)
    assert str(caught.value) == (
        "the lease NO:SUCH{PV} is not there, or may not be written; let the machine's IOC serve "
        "it, or name another with lease.pv"
    )


@pytest.mark.parametrize(
    ("ioc_option", "addresses"),
    [("127.0.0.1:5064", ""), ("config", ""), ("env", "127.0.0.1"), ("env", "127.0.0.1:5064")],
)
def test_the_port_of_production_is_refused_unless_it_is_meant(
    ioc_option: str, addresses: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("EPICS_CA_ADDR_LIST", addresses)
    if ":" not in addresses:
        monkeypatch.delenv("EPICS_CA_SERVER_PORT")
    epics = find_ring(load_config(), ioc_option)
    with pytest.raises(ConfigError, match="that is port 5064, on which machines are; give --live"):
        check_live(epics, ioc_option, None, False)
    check_live(epics, ioc_option, None, True)
    with pytest.raises(ConfigError, match="--live starts OPEN, whatever --start says"):
        check_live(epics, ioc_option, "closed", True)


def test_an_accident_is_told_before_anything_is_made(tmp_path: Path):
    told = refused("run", "--ioc", "127.0.0.1:5064", "--data", tmp_path / "data")
    assert told.startswith("--ioc 127.0.0.1:5064: that is port 5064, on which machines are")
    assert not (tmp_path / "data").exists()
