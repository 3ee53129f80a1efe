"""The response measured by a running loop, over Channel Access: started, watched, ended by PV."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fault_session import Session, fault_session
from service_process import CHANNELS, Service, wait_for
from test_panel import PREFIX, operate

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError
from orbitfb.measure.response_file import read_response
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store.directory import PolicyStore

pytestmark = pytest.mark.system

MEASURED = (3, 40, 41, 100, 140, 179)
MORE = f"""
[panel]
enabled = true
port = 0
period = 0.1
prefix = "{PREFIX}"
[measure]
orbits = 2
check = 1
[masks]
correctors = {[name for j, name in enumerate(CHANNELS.correctors) if j not in MEASURED]!r}
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    """A loop that is good; every test leaves it OPEN, its setpoints as they were."""
    still = {"initial_orbit_rms": 0.0, "ground_motion_rms": 0.0}
    where = tmp_path_factory.mktemp("measure")
    with fault_session(where, MORE, plant=still) as session:
        yield session


def measure(session: Session, **arguments: object) -> Any:
    return ask(session.service.data, {"command": "measure", **arguments}, timeout=30.0)


def begun(session: Session, before: np.ndarray, **arguments: object) -> None:
    """Start a measurement and wait until it has moved a corrector."""
    measure(session, action="start", **arguments)
    wait_for("motion", lambda: moved(session, before) or measure(session)["state"] != "MEASURING")
    told = measure(session)
    assert told["state"] == "MEASURING", told["text"]


def opened(session: Session) -> np.ndarray:
    """Open the loop; gives the setpoints, which stay."""
    session.fault(current=400.0)
    session.command("open")
    ticks = session.service.status()["ticks"]
    session.service.wait_status("ticks", lambda status: status["ticks"] > ticks + 10, 20.0)
    return session.setpoints()


def moved(session: Session, before: np.ndarray) -> bool:
    return bool(np.abs(session.setpoints() - before).max() > 1e-3)


def ended(session: Session) -> Any:
    return wait_for(
        "end",
        lambda: (
            (told := measure(session))["seconds_left"] == 0
            and "begins" not in told
            and told["state"] not in ("MEASURING", "PUTTING BACK")
            and told
        ),
    )


def test_a_closed_loop_refuses_it_with_a_reason(session: Session):
    why = "measurement of the response refused: the loop is CLOSED; `open` it first"
    with pytest.raises(ControlError, match=why):
        measure(session, action="start")
    operate(session.service, 'put("Measure-Cmd", "start"); finish(text("MeasureState-I"))')
    told = session.service.events("command_refused")
    assert why in told[-1]["reason"] and told[-1]["door"] == "panel"
    assert session.service.status()["state"] == "CLOSED"


def test_the_matrix_is_measured_by_pv_and_offered_but_not_put_in_force(session: Session):
    before = opened(session)
    active = session.service.status()["policy"]
    seen = operate(
        session.service,
        """
        until(lambda: text("State-I") == "OPEN", "OPEN")
        put("Measure-Cmd", "start")
        until(lambda: 0 < get("MeasureDone-I") < 6, "progress")
        middle = {
            "state": text("MeasureState-I"), "total": get("MeasureTotal-I"),
            "left": get("MeasureLeft-I"), "share": get("MeasureShare-I"),
        }
        put("Command-Cmd", "close")
        put("Undo-Cmd", "do")
        refused = text("State-I")
        until(lambda: text("MeasureState-I") == "DONE", "the end")
        finish({**middle, "closed": refused, "text": text("MeasureText-I")})
        """,
    )
    assert (seen["state"], seen["total"], seen["closed"]) == ("MEASURING", 6, "OPEN")
    assert 0 < seen["share"] < 100 and 0 < seen["left"] < 120
    reasons = [line["reason"] for line in session.service.events("command_refused")]
    told = "close refused: measurement of the response is under way; abort it first"
    assert told in reasons
    answer = measure(session)
    found = read_response(Path(answer["file"]), CHANNELS)
    true = response(Ring.load(), "x")[:, MEASURED]
    apart = found.table.response[:, MEASURED] - true
    assert np.linalg.norm(apart) / np.linalg.norm(true) < 0.02
    np.testing.assert_array_equal(session.setpoints(), before)
    store = PolicyStore(session.service.data / "policies")
    policy = store.load(answer["policy"], CHANNELS)
    np.testing.assert_array_equal(policy.response[:, MEASURED], found.table.response[:, MEASURED])
    assert session.service.status()["policy"] == active != answer["policy"]
    assert f"policies activate {answer['policy']}" in seen["text"]
    assert [line["correctors"] for line in session.service.events("response_measurement_started")]


def test_it_is_aborted_by_pv_and_all_is_put_back(session: Session):
    before = opened(session)
    begun(session, before, at_once=0, fresh=True)
    seen = operate(
        session.service,
        """
        put("Measure-Cmd", "abort")
        until(lambda: text("MeasureState-I") == "ABORTED", "the end")
        finish(text("MeasureText-I"))
        """,
    )
    assert "aborted" in seen and "the setpoints are back" in seen
    np.testing.assert_allclose(session.setpoints(), before, atol=1e-9)
    with pytest.raises(ControlError, match="nothing is being measured"):
        measure(session, action="abort")


LOST = {
    "a corrector that does not follow": (
        {"correctors": {"40": 5.0}},
        "do not follow their setpoint: CL2B_C06",
    ),
    "a readback that is away": ({"correctors": {"100": "away"}}, CHANNELS.correctors[100]),
    "twenty BPMs": ({"bpms": {str(j): "nan" for j in range(20)}}, "BPMs are invalid"),
    "the beam": ({"current": 0.0}, "current"),
    "the orbit": ({"bpms": {str(j): 2e-3 for j in range(180)}}, "µm"),
}


@pytest.mark.parametrize("what", LOST)
def test_what_is_lost_in_the_middle_ends_it_and_all_is_put_back(session: Session, what: str):
    fault, told = LOST[what]
    before = opened(session)
    begun(session, before, at_once=0, fresh=True)
    session.fault(**fault)
    answer = ended(session)
    assert answer["state"] == "FAILED", answer
    assert told in answer["text"] and answer["text"].endswith("; the setpoints are back")
    np.testing.assert_allclose(session.setpoints(), before, atol=1e-9)
    assert session.service.status()["state"] == "OPEN"
    operate(session.service, 'until(lambda: text("MeasureState-I") == "FAILED", ""); finish(1)')


def test_a_dead_corrector_is_named_and_no_policy_is_offered(session: Session):
    before = opened(session)
    session.fault(correctors={"40": "off"})
    measure(session, action="start", fresh=True)
    answer = ended(session)
    assert answer["state"] == "DONE" and "policy" not in answer, answer["text"]
    assert "1 correctors and 0 BPMs are bad" in answer["text"]
    assert [*answer["bad_correctors"]] == [CHANNELS.correctors[40]]
    np.testing.assert_array_equal(session.setpoints(), before)


def test_the_loop_does_not_close_on_a_policy_that_loses_the_beam_on_what_was_measured(
    session: Session,
):
    opened(session)
    session.fault(sign=-1.0)
    measure(session, action="start", fresh=True)
    answer = ended(session)
    assert answer["state"] == "DONE", answer["text"]
    assert "which is in force, would lose the beam" in answer["loop"]["x"]
    with pytest.raises(ControlError, match=r"close refused: policy .* would lose the beam"):
        session.command("close")
    session.fault(sign=1.0)
    measure(session, action="start", fresh=True)
    answer = ended(session)
    assert "which is in force, holds" in answer["loop"]["x"]
    session.command("close")
    session.command("open")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"action": "begin"}, "action must be status, start, abort, not 'begin'"),
        ({"action": "start", "at_once": -1}, "at_once must be a count of correctors, not -1"),
        ({"action": "start", "fresh": 1}, "fresh and restore must be true or false"),
        ({"action": "abort", "fresh": True}, "fresh goes with action=start only"),
        ({"speed": 1}, "speed is unknown"),
    ],
)
def test_what_makes_no_sense_is_refused(session: Session, arguments: Any, told: str):
    with pytest.raises(ControlError, match=told):
        measure(session, **arguments)


def test_somebody_elses_hand_ends_it_and_what_it_moved_stays(session: Session):
    before = opened(session)
    begun(session, before, fresh=True)
    session.client.put_waiting(CHANNELS.setpoint_pvs[60], 0.25)
    answer = ended(session)
    names = (CHANNELS.setpoint_pvs[60], CHANNELS.correctors[60])
    assert answer["state"] == "FAILED" and any(name in answer["text"] for name in names)
    after = session.setpoints()
    assert after[60] == 0.25
    session.client.put_waiting(CHANNELS.setpoint_pvs[60], before[60])
    np.testing.assert_allclose(session.setpoints(), before, atol=1e-9)


@pytest.mark.nightly
def test_a_service_that_stops_puts_back_first_and_one_that_is_killed_at_its_next_start(
    session: Session,
):
    before = opened(session)
    service, options = session.service, ("--config", session.service.data.parent / "c.toml")
    begun(session, before, at_once=0, fresh=True)
    service.stop(signal.SIGTERM)
    np.testing.assert_allclose(session.setpoints(), before, atol=1e-9)
    where = f"127.0.0.1:{session.port}"
    with Service(service.data, where, *options, "--start", "open") as again:
        session.service = again
        opened(session)
        begun(session, before, at_once=0, fresh=True)
        again.kill()
    assert moved(session, before)
    with Service(service.data, where, *options, "--start", "open") as third:
        session.service = third
        wait_for("warning", lambda: third.events("setpoints_astray"))
        opened(session)
        with pytest.raises(
            ControlError, match="give restore=true to put them back, or restore=false"
        ):
            measure(session, action="start", at_once=0, fresh=True)
        begun(session, before, at_once=0, fresh=True, restore=True)
        assert measure(session, action="abort")["state"] == "ABORTED"
        np.testing.assert_allclose(session.setpoints(), before, atol=1e-9)
