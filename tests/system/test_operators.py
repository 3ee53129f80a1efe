"""What operators do by PV while the loop is open, over Channel Access: one service, one story."""

from collections.abc import Iterator

import pytest
from ioc_clients import CHANNELS, run_client
from service_process import Service
from test_panel import operate, start

from orbitfb.control.socket import ask
from orbitfb.core.errors import ControlError

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with start(tmp_path_factory.mktemp("operators")) as service:
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
    ask(service.data, {"command": "correct", "once": True})  # of what is there now
