"""The panel over Channel Access, as an operator's screens use it: pyepics in another process."""

import getpass
import os
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ioc_clients import KICK, run_client
from service_process import Service, refused, wait_for

from orbitfb import __version__
from orbitfb.control.client import ask
from orbitfb.panel.pv_table import Extent, panel_pvs
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response

pytestmark = pytest.mark.system

PREFIX = "TST:FB{Orbit}"
HEAD = f"""
import json, os, time
import epics

def get(name, **how):
    return epics.caget({PREFIX!r} + name, timeout=60.0, **how)

def text(name):
    return get(name, as_string=True)

def put(name, value):
    epics.caput({PREFIX!r} + name, value, wait=True, timeout=60.0)

def until(look, what):
    end = time.monotonic() + 60.0
    while not look():
        assert time.monotonic() < end, what
        time.sleep(0.05)

def finish(answer):
    print(json.dumps(answer), flush=True)
    os._exit(0)
"""


def panel_port(service: Service) -> int:
    return int(service.where["panel"].split(":")[1])


def operate(service: Service, script: str) -> Any:
    """Run a pyepics script against the panel; gives what it hands to `finish`."""
    return run_client(panel_port(service), HEAD + textwrap.dedent(script))


def logged(service: Service, event: str, what: str) -> list[dict[str, Any]]:
    """Lines of the log about commands, once one with `what` in it is there."""
    wait_for(what, lambda: any(what in str(line) for line in service.events(event)), 5.0)
    return service.events(event)


def start(directory: Path, *options: object) -> Service:
    rules, config = directory / "rules.toml", directory / "config.toml"
    rules.write_text(
        f"""
        [[rule]]
        pvs = ["*-SP", "[!A]*-Cmd"]
        users = ["{getpass.getuser()}"]
        hosts = ["127.0.0.1"]
        """
    )
    config.write_text(
        f"""
        [panel]
        enabled = true
        port = 0
        period = 0.1
        prefix = "{PREFIX}"
        rules = "{rules}"
        """
    )
    return Service(directory / "data", "sim", "--start", "open", "--config", config, *options)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A loop that starts OPEN; the tests are one story, in order."""
    with start(tmp_path_factory.mktemp("panel")) as service:
        yield service


def test_it_says_where_the_panel_is(service: Service):
    assert f"panel of the PVs {PREFIX}… on 127.0.0.1:{panel_port(service)}" in service.out


def test_it_shows_the_loop(service: Service):
    seen = operate(
        service,
        """
        until(lambda: text("State-I") == "OPEN", "OPEN")
        first = get("Heartbeat-I")
        until(lambda: get("Heartbeat-I") > first + 2, "heartbeat")
        usual = lambda name: 50 < get(name) < 150
        until(lambda: usual("TickRead-I") and usual("Period-I"), "usual times")
        names = json.loads(text("PVs-I"))
        away = [name for name in names if epics.caget(name, timeout=5.0) is None]
        finish({
            "version": text("Version-I"),
            "names": names,
            "away": away,
            "rms": get("RmsX-I"),
            "gain": [get("GainX-SP"), get("GainX-RB")],
            "limits": epics.PV("%sGainX-SP").get_ctrlvars(),
            "policy": text("Policy-I"),
        })
        """.replace("%s", PREFIX),
    )
    pvs = panel_pvs(PanelSettings(), Extent("x", 180, 180))
    assert seen["names"] == [PREFIX + pv.name for pv in pvs] and seen["away"] == []
    assert seen["version"] == __version__ and seen["policy"].startswith("svd-")
    assert seen["rms"] == pytest.approx(250.0, rel=0.1)
    assert seen["gain"] == [1.0, 1.0]
    assert (seen["limits"]["lower_ctrl_limit"], seen["limits"]["upper_ctrl_limit"]) == (0.0, 1.0)


def test_it_commands_the_loop_and_the_log_says_who_did(service: Service):
    seen = operate(
        service,
        """
        lines = []
        pv = epics.PV("%sLogLine-I", callback=lambda char_value=None, **_: lines.append(char_value))
        assert pv.wait_for_connection(60.0)
        put("Command-Cmd", "close")
        until(lambda: text("State-I") == "CLOSED", "CLOSED")
        until(lambda: get("RmsX-I") < 1.0, "below a micrometre")
        finish(lines)
        """.replace("%s", PREFIX),
    )
    assert any("close by" in line or "state: CLOSED" in line for line in seen), seen
    [line] = [its for its in logged(service, "command_given", "close") if its["command"] == "close"]
    assert line["user"] == getpass.getuser()
    assert (line["host"], line["door"]) == ("127.0.0.1", "panel")
    assert line["pv"] == f"{PREFIX}Command-Cmd"


def test_the_other_door_is_the_same_and_logged_alike(service: Service):
    ask(service.data, {"command": "shadow"})
    ask(service.data, {"command": "close"})
    wait_for("close", lambda: service.events("command_given")[-1]["command"] == "close", 5.0)
    line = service.events("command_given")[-1]
    assert (line["command"], line["door"], line["user"]) == ("close", "socket", getpass.getuser())


def test_beyond_its_limits_or_illegal_is_refused_with_alarm_and_log(service: Service):
    seen = operate(
        service,
        """
        if text("State-I") != "CLOSED":
            put("Command-Cmd", "close")
            until(lambda: text("State-I") == "CLOSED", "CLOSED")

        def halved():
            put("GainX-SP", 0.5)
            return get("GainX-SP") == 0.5  # a busy service may not answer in time

        until(halved, "half the gain")
        kept = []
        for value in (1.5, -0.1, float("nan")):
            put("GainX-SP", value)
            kept.append([get("GainX-SP"), get("GainX-RB")])
        alarm = epics.PV("%sGainX-SP", form="time")
        alarm.get()
        put("Reset-Cmd", "do")

        lines = []

        def told():
            put("Dither-SP", 1000.0)  # anew, as another line may have followed
            lines.append(text("LogLine-I"))
            return "Dither-SP" in lines[-1]

        until(told, "log line")
        finish({"kept": kept, "alarm": alarm.severity, "line": lines[-1],
                "state": text("State-I")})
        """.replace("%s", PREFIX),
    )
    assert seen["kept"] == [[0.5, 0.5]] * 3
    assert seen["alarm"] == 2  # MAJOR
    assert "refused: Dither-SP: 1000 is not from 0 to 20 um" in seen["line"]
    assert seen["state"] == "CLOSED"
    reasons = [line["reason"] for line in logged(service, "command_refused", "Dither-SP")]
    assert "GainX-SP: 1.5 is not from 0 to 1" in reasons
    assert "reset refused in CLOSED: there is nothing to reset" in reasons


def test_who_may_not_write_does_not_and_is_logged(service: Service):
    seen = operate(
        service,
        """
        may = {}
        for name in ("GainX-SP", "Activate-Cmd", "Apply-Cmd", "State-I"):
            pv = epics.PV("%s" + name)
            pv.wait_for_connection(5.0)
            may[name] = [pv.read_access, pv.write_access]
        finish(may)
        """.replace("%s", PREFIX),
    )
    assert seen["GainX-SP"] == [True, True]
    for name in ("Activate-Cmd", "Apply-Cmd", "State-I"):
        assert seen[name] == [True, False]
    # a client that does not heed what it was told, and another user
    script = f"""
        import json
        from caproto.sync.client import read, write
        name = "{PREFIX}GainX-SP"
        try:
            write(name, [0.125], notify=True, repeater=False, timeout=5.0)
        except Exception:
            pass
        print(json.dumps(float(read(name, repeater=False).data[0])))
        """
    os.environ["LOGNAME"], before = "mallory", os.environ.get("LOGNAME")
    try:
        assert run_client(panel_port(service), script) == 0.5
    finally:
        os.environ.pop("LOGNAME")
        if before is not None:
            os.environ["LOGNAME"] = before


def test_vectors_show_orbit_setpoints_and_modes(service: Service):
    seen = operate(
        service,
        """
        def whole(name):
            pv = epics.PV("%s" + name, auto_monitor=False)
            control = pv.get_ctrlvars(timeout=60.0)
            return [pv.count, control.get("units"), list(pv.get(timeout=60.0))]

        until(lambda: abs(get("ErrorX-I")).max() < 5.0, "errors of a closed loop")
        finish({
            "error": whole("ErrorX-I"),
            "setpoint": whole("SetpointX-I"),
            "room": get("RoomX-I").tolist(),
            "sigma": get("SingularValueX-I").tolist(),
            "gains": get("ModeGainX-I").tolist(),
            "shadow": bool((get("ShadowX-I") != get("ShadowX-I")).all()),
            "names": list(get("BpmNameX-I")),
            "places": get("BpmPositionX-I").tolist(),
            "used": get("BpmUsedX-I").tolist(),
        })
        """.replace("%s", PREFIX),
    )
    ring = Ring.load()
    count, units, errors = seen["error"]
    assert (count, units) == (180, "um") and 0.05 < np.std(errors) < 2.0
    count, units, setpoints = seen["setpoint"]
    assert (count, units) == (180, "A") and 0.01 < np.std(setpoints) < 5.0
    np.testing.assert_allclose(seen["room"], 17.5 - np.abs(setpoints), atol=0.02)
    np.testing.assert_allclose(seen["sigma"], np.linalg.svd(response(ring, "x"))[1], atol=1e-8)
    assert 0.0 < min(seen["gains"]) <= max(seen["gains"]) <= 1.0
    assert seen["shadow"] and seen["used"] == [1] * 180
    assert tuple(seen["names"]) == ring.names("BPM")
    assert seen["places"] == pytest.approx(ring.table.s[ring.places("BPM")].tolist())


def test_devices_reference_and_cut_are_adjusted_while_closed(service: Service):
    seen = operate(
        service,
        """
        import numpy as np
        correctors = np.ones(180, dtype=int)
        correctors[7] = 0
        put("CorrectorEnable-SP", correctors)
        until(lambda: get("CorrectorEnable-RB").sum() == 179, "corrector")
        put("Reference-SP", np.full(180, 0.02))
        on_the_way = float(np.abs(get("Reference-RB")).max())
        until(lambda: abs(get("Reference-RB")[9] - 0.02) < 1e-9, "reference")
        put("Modes-SP", 60)
        until(lambda: get("PredictedMax-I") > 0, "prediction")
        predicted, modes, state = get("PredictedMax-I"), int(get("Modes-RB")), text("State-I")
        put("Reference-SP", np.zeros(180))
        until(lambda: not get("Reference-RB").any(), "reference back")
        finish({"way": on_the_way, "predicted": predicted, "modes": modes, "state": state})
        """,
    )
    assert seen["way"] < 0.02  # slowly
    assert 0 < seen["predicted"] < 1.0
    assert (seen["modes"], seen["state"]) == (180, "CLOSED")
    wait_for("log", lambda: service.events("command_given")[-2]["command"] == "try", 5.0)
    commands = [line["command"] for line in service.events("command_given")]
    assert commands[-4:] == ["enable-correctors", "reference", "try", "reference"]


def test_a_trip_is_told_and_stays_told_after_the_reset(service: Service):
    run_client(
        service.port,
        f"""
        from caproto.sync.client import write
        write({KICK!r}, [3.0], notify=True, repeater=False)
        print(1)
        """,
    )
    seen = operate(
        service,
        """
        until(lambda: text("State-I") == "TRIPPED", "trip")
        reason = text("Reason-I")
        put("Reset-Cmd", "do")
        until(lambda: text("State-I") == "OPEN", "reset")
        finish({"reason": reason, "last": text("LastTrip-I")})
        """,
    )
    assert "orbit error" in seen["reason"]
    assert seen["last"].endswith(seen["reason"])


def test_a_panel_that_dies_comes_back_and_settings_outlive_the_service(service: Service):
    child = service.child("orbitfb.panel")
    before = service.status()
    child.kill()
    wait_for("the panel", lambda: len(service.events("panel_started")) == 2)
    after = service.status()
    assert after["ticks"] > before["ticks"] and after["state"] == before["state"]
    assert service.events("panel_died")
    service.kill()
    with start(service.data.parent) as again:
        assert again.events("operator_settings_restored")
        seen = operate(
            again,
            """
            until(lambda: text("State-I") == "OPEN", "OPEN")
            finish([get("GainX-SP"), get("GainX-RB"), int(get("CorrectorEnable-RB").sum())])
            """,
        )
        assert seen == [0.5, 0.5, 179]


def test_a_wrong_rule_is_told_before_anything_runs(tmp_path: Path):
    config, rules = tmp_path / "config.toml", tmp_path / "rules.toml"
    rules.write_text('[[rule]]\npvs = ["Gian*"]\n')
    config.write_text(f'[panel]\nenabled = true\nrules = "{rules}"\n')
    told = refused("run", "--ioc", "sim", "--data", tmp_path / "data", "--config", config)
    assert told.startswith(f"{rules}: the pattern 'Gian*' fits no PV that can be written; those")
    assert not (tmp_path / "data").exists()
