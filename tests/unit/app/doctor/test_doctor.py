"""The doctor finds what is wrong, says what to do, and leaves nothing behind."""

import errno
import json
import os
import socket

import pytest

from orbitfb.app.doctor import clock, files, program
from orbitfb.app.doctor.examine import examine
from orbitfb.app.doctor.finding import Finding, Verdict, as_text
from orbitfb.app.doctor.network import look_at_environment, look_at_ports
from orbitfb.app.doctor.ring import look_at_ring
from orbitfb.cli.app import app
from orbitfb.config.load import load_config
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.physics.places import Ring

RING = Ring.load()


def by_check(findings):
    return {each.check: each for each in findings}


@pytest.fixture
def taken():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


def test_the_command_tells_people_and_programs_the_same(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ORBITFB_OBSERVE__PORT", "0")
    code = app(["doctor"], standalone_mode=False)
    text = capsys.readouterr().out
    assert app(["doctor", "--json"], standalone_mode=False) == code
    answer = json.loads(capsys.readouterr().out)
    assert code in (None, 0) and answer["healthy"]
    for each in answer["findings"]:
        assert each["check"] in text
    assert not list(tmp_path.iterdir()), "nothing is made by looking"


def test_a_wrong_configuration_is_found_and_the_rest_still_looked_at(tmp_path, capsys):
    (tmp_path / "bad.toml").write_text("[loop]\nrate = 10\n")
    assert app(["doctor", "--config", str(tmp_path / "bad.toml")], standalone_mode=False) == 1
    text = capsys.readouterr().out
    assert "loop.rate: no such key" in text and "did you mean" in text
    assert "python" in text and "see above" in text


@pytest.mark.parametrize(
    ("key", "content", "check"),
    [
        ("ring.places", "name,kind\n", "ring"),
        ("ring.response", "noise", "ring"),
    ],
)
def test_tables_of_the_ring_are_read(tmp_path, key, content, check):
    (tmp_path / "file").write_text(content)
    found = by_check(examine(None, {key: str(tmp_path / "file")}, None, False, 1.0))
    assert found[check].verdict is Verdict.FAILED
    assert found["file"].verdict is Verdict.OK


def test_a_damaged_policy_is_found(tmp_path):
    (tmp_path / "policies").mkdir()
    (tmp_path / "policies/active.json").write_text("{")
    found = by_check(examine(None, {"data_directory": tmp_path}, None, False, 1.0))
    assert found["policy"].verdict is Verdict.FAILED


def test_a_data_directory_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("in the way")
    config = AppConfig(data_directory=tmp_path / "file")
    found = by_check(files.look_at_files(config, RING))
    assert found["data directory"].verdict is Verdict.FAILED
    config = AppConfig(data_directory=tmp_path / "new/deeper")
    assert by_check(files.look_at_files(config, RING))["data directory"].verdict is Verdict.OK
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("free", "verdict"), [(1e8, Verdict.FAILED), (1e9, Verdict.WARNING), (1e12, Verdict.OK)]
)
def test_a_full_disk(tmp_path, monkeypatch, free, verdict):
    usage = files.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: usage._replace(free=int(free)))
    found = by_check(files.look_at_files(AppConfig(data_directory=tmp_path), RING))["disk"]
    assert found.verdict is verdict and bool(found.advice) is (verdict is not Verdict.OK)
    # 180 BPMs: orbit and reference of 8 bytes, valid of 1; 180 correctors: 5 columns of 8
    expected = (180 * (8 + 8 + 1) + 180 * 5 * 8) * 10 * 86_400
    assert found.figures["archive_bytes_per_day"] == pytest.approx(expected, rel=0.03)


def test_ports_that_somebody_has(taken):
    config = load_config(None, {"observe.port": taken, "sim.port": 0, "web.port": 0})
    found = by_check(look_at_ports(config, running=False))
    assert found["metrics"].verdict is Verdict.WARNING and "in use" in found["metrics"].told
    assert found["simulated ring"].verdict is Verdict.OK
    assert by_check(look_at_ports(config, running=True))["metrics"].verdict is Verdict.OK


def test_a_port_only_taken_over_udp_is_taken():
    with socket.socket(type=socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        port = own.getsockname()[1]
        config = load_config(None, {"sim.port": port, "observe.enabled": False, "web.port": 0})
        found = by_check(look_at_ports(config, running=False))["simulated ring"]
    assert found.verdict is Verdict.WARNING and "(udp)" in found.told
    assert by_check(look_at_ports(config, running=False))["simulated ring"].verdict is Verdict.OK


def test_an_address_that_is_not_ours():
    config = load_config(None, {"observe.host": "192.0.2.1", "sim.port": 0, "web.port": 0})
    found = by_check(look_at_ports(config, running=False))["metrics"]
    assert found.verdict is Verdict.WARNING and os.strerror(errno.EADDRNOTAVAIL) in found.told


@pytest.mark.parametrize(
    ("name", "value", "verdict"),
    [
        ("EPICS_CA_ADDR_LIST", "10.0.0.255", Verdict.OK),
        ("EPICS_CA_AUTO_ADDR_LIST", "FALSE", Verdict.WARNING),
        ("EPICS_CA_SERVER_PORT", "80", Verdict.WARNING),
        ("EPICS_CA_NAME_SERVERS", "gateway:5064", Verdict.OK),
        ("EPICS_CA_MAX_ARRAY_BYTES", "lots", Verdict.WARNING),
    ],
)
def test_variables_of_the_environment(name, value, verdict):
    (found,) = look_at_environment({name: value, "HOME": "/root"})
    assert (found.check, found.verdict) == (name, verdict)
    assert bool(found.advice) is (verdict is Verdict.WARNING)


def test_old_and_missing_packages(monkeypatch):
    def requires(_):
        return ["numpy>=99", "no-such-package>=1", "pyarrow>=1; extra == 'parquet'"]

    monkeypatch.setattr(program.importlib.metadata, "requires", requires)
    found = by_check(program.look_at_program())["packages"]
    assert found.verdict is Verdict.FAILED
    assert "numpy" in found.told and "no-such-package is missing" in found.told


def test_a_clock_that_was_never_set(monkeypatch):
    monkeypatch.setattr(clock.time, "time", lambda: 86_400.0)
    found = by_check(clock.look_at_clock())
    assert found["time"].verdict is Verdict.FAILED
    monkeypatch.setattr(clock, "_kernel_status", lambda: False)
    assert by_check(clock.look_at_clock())["synchronised"].verdict is Verdict.WARNING


def test_no_machine_is_asked_by_accident(monkeypatch):
    monkeypatch.setattr("orbitfb.app.doctor.ring.Context", lambda: pytest.fail("searched for PVs"))
    for ioc, word in (("192.0.2.1:15064", "beyond this computer"), ("127.0.0.1:5064", "5064")):
        with pytest.raises(ConfigError, match=word):
            list(look_at_ring(AppConfig(), RING, ioc, False, 1.0))
    (found,) = look_at_ring(AppConfig(), RING, None, False, 1.0)
    assert found.verdict is Verdict.SKIPPED


def test_every_interface_is_never_searched(monkeypatch):
    monkeypatch.setattr("orbitfb.app.doctor.ring.Context", lambda: pytest.fail("searched for PVs"))
    monkeypatch.setenv("EPICS_CA_AUTO_ADDR_LIST", "YES")
    monkeypatch.setenv("EPICS_CA_ADDR_LIST", "")
    found = [*look_at_ring(AppConfig(), RING, "env", True, 1.0)]
    assert [each.verdict for each in found] == [Verdict.WARNING, Verdict.SKIPPED]


def test_the_text_ends_with_what_to_do():
    text = as_text([Finding("a", "b", Verdict.FAILED, "broken", "repair it")])
    assert text.splitlines()[-3:] == ["  b: repair it", "", "1 failed"]
