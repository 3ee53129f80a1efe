"""What operators do by PV while the loop is open, over Channel Access: one service, one story."""

import json
from collections.abc import Iterator

import pytest
from ioc_clients import CHANNELS, run_client
from service_process import Service, orbitfb, refused
from test_panel import operate, start

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with start(tmp_path_factory.mktemp("operators"), "--rate", 30) as service:
        yield service


def test_a_correction_is_computed_looked_at_applied_and_undone(service: Service):
    seen = operate(
        service,
        """
        until(lambda: get("RmsX-I") > 100, "the first orbit")
        first = get("SetpointX-I")
        put("CorrectCompute-Cmd", "baseline")
        until(lambda: get("CorrectMax-I") > 0, "preview")
        preview = get("PreviewX-I")
        expected, moved = get("CorrectOrbit-I"), abs(get("SetpointX-I") - first).max()
        put("CorrectApply-Cmd", "do")
        until(lambda: get("Undos-I") == 1, "applied")
        until(lambda: get("RmsX-I") < 10, "the corrected orbit")
        after, there = get("RmsX-I"), get("SetpointX-I") - first
        put("Undo-Cmd", "do")
        until(lambda: get("Undos-I") == 0, "undone")
        until(lambda: get("RmsX-I") > 100, "the first orbit again")
        until(lambda: abs(get("SetpointX-I") - first).max() < 1e-5, "the first setpoints")
        finish({
            "moved": float(moved), "expected": expected, "after": after,
            "as_shown": float(abs(there - preview).max()), "largest": float(abs(preview).max()),
            "told": text("CorrectText-I"), "state": text("State-I"),
        })
        """,
    )
    assert seen["moved"] == 0.0
    assert seen["as_shown"] < 1e-5 < seen["largest"]
    assert seen["expected"] < 2.0 and seen["after"] < 5.0
    assert seen["told"].startswith("undo of correction by svd-") and seen["state"] == "OPEN"
    assert [line["steps"] for line in service.events("correction_done")] == [1, 1]


def test_what_somebody_moved_meanwhile_is_not_corrected_over(service: Service):
    ask(service.data, {"command": "correct", "once": True})
    ask(service.data, {"command": "correct"})
    run_client(
        service.port,
        f"""
        from caproto.sync.client import write
        write({CHANNELS.setpoint_pvs[3]!r}, [0.5], notify=True, repeater=False)
        print(1)
        """,
    )
    for command in ("correct-apply", "undo"):
        with pytest.raises(ControlError, match=r"refused: .*(moved|setpoints are not)"):
            ask(service.data, {"command": command})
    operate(service, 'put("Undo-Cmd", "do"); finish(text("State-I"))')
    assert "refused" in ask(service.data, {"command": "panel"})["figures"]["CorrectText-I"]
    told = orbitfb("command", "correct", "--once", "--data", service.data, "--json")
    answer = json.loads(told.stdout)  # of what is there now
    assert answer["can_be_undone"] == 2 and answer["after_rms_um"] < 5.0


def test_what_makes_no_sense_is_refused_by_the_command_line(service: Service):
    for words, reason in (
        (("correct", "law=best"), "law must be baseline or active, not 'best'"),
        (("close", "--once"), "close takes nothing with it: once is unknown"),
        (("bump", "place=NOWHERE"), "bump refused: no source 'NOWHERE'"),
    ):
        assert reason in refused("command", *words, "--data", service.data)


PLACE = "PL1B_C30,PL1A_C01"


def test_a_bump_moves_the_orbit_at_its_place_and_nowhere_else(service: Service):
    ask(service.data, {"command": "close"})
    seen = operate(
        service,
        f"""
        import numpy as np
        until(lambda: get("RmsX-I") < 1.0, "a closed loop")

        def orbit():
            return np.mean([(time.sleep(0.1), get("OrbitX-I"))[1] for _ in range(10)], axis=0)

        before = orbit()
        put("BumpPlace-SP", {PLACE!r})
        until(lambda: text("BumpPlace-RB") == {PLACE!r}, "the place")
        put("BumpPositionX-SP", 60.0)
        put("BumpAngleX-SP", -8.0)
        put("BumpAngleX-SP", 300.0)  # beyond its limit
        until(lambda: get("BumpAngleX-RB") == -8.0, "the bump")
        names, where = list(get("BpmNameX-I")), get("BpmPositionX-I")
        ends = [names.index(name) for name in {PLACE!r}.split(",")]
        until(lambda: abs(get("Reference-RB")[ends].mean() - 0.06) < 1e-6, "the reference there")
        until(lambda: abs(get("ErrorX-I")[ends].mean()) < 0.3, "the orbit there: weak modes")
        after, words = orbit(), text("Bumps-I")
        put("BumpPositionX-SP", 0.0)
        put("BumpAngleX-SP", 0.0)
        until(lambda: not get("Reference-RB").any() and get("RmsX-I") < 1.0, "gone")
        finish({{
            "moved": (1e3 * (after - before)).tolist(), "names": names, "where": where.tolist(),
            "words": words, "left": text("Bumps-I"), "state": text("State-I"),
        }})
        """,
    )
    left, right = (seen["names"].index(name) for name in PLACE.split(","))
    moved, where = seen["moved"], seen["where"]
    assert (moved[left] + moved[right]) / 2 == pytest.approx(60.0, abs=1.0)
    slope = (moved[right] - moved[left]) / (where[right] - where[left])
    assert slope == pytest.approx(-8.0, abs=0.3)
    assert seen["words"] == f"{PLACE} x 60 um -8 urad" and seen["left"] == ""
    assert max(map(abs, [*moved[right + 5 :], *moved[: left - 5]])) < 2.0
    assert seen["state"] == "CLOSED"


def test_averages_and_a_dead_band_are_set_by_pv_and_told_in_the_status(service: Service):
    seen = operate(
        service,
        """
        put("Average-SP", 2000)  # beyond its limit
        put("Average-SP", 15)
        until(lambda: get("Average-RB") == 15, "the average")

        def moves(looks):
            seen = []
            for _ in range(looks):
                time.sleep(0.1)
                seen.append(bool(get("AppliedX-I").any()))
            return sum(seen) / looks

        put("DeadBandX-SP", 20.0)
        until(lambda: get("DeadBandX-RB") == 20.0, "the dead band")
        until(lambda: moves(8) == 0, "rest, and no question")
        until(lambda: text("State-I") == "CLOSED", "CLOSED")  # a busy machine holds a tick back
        finish(True)
        """,
    )
    assert seen
    status = service.status()
    assert status["average_orbits"] == 15
    assert status["dead_band_um"] == {"x": pytest.approx(20.0)}


def test_weights_of_the_bpms_are_tried_and_applied(service: Service):
    seen = operate(
        service,
        """
        import numpy as np
        put("BpmWeight-SP", np.full(180, -1.0))  # beyond their limits
        weights = np.ones(180)
        weights[3] = 0.0
        put("BpmWeight-SP", weights)
        until(lambda: get("PredictedOrbit-I") > 0, "a prediction")
        finish(get("BpmWeight-RB").tolist())
        """,
    )
    assert seen == [1.0] * 180  # tried, not in force
    policy = ask(service.data, {"command": "apply"})["policy"]
    service.wait_status("policy", lambda status: status["policy"] == policy, 10.0)
    shown = ask(service.data, {"command": "panel"})["figures"]["BpmWeight-RB"]
    assert shown == [1.0] * 3 + [0.0] + [1.0] * 176
    # A busy machine holds a tick back now and then.
    service.wait_status("closed", lambda status: status["state"] == "CLOSED", 10.0)
