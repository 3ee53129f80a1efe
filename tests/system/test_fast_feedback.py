"""Beside a fast feedback, over Channel Access: while its status says closed, we are not."""

from pathlib import Path

import pytest
from service_process import Service

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError

pytestmark = pytest.mark.system


def test_close_is_refused_while_the_fast_feedback_is_closed(tmp_path: Path):
    config = tmp_path / "config.toml"
    config.write_text(
        """
        [interlocks]
        fast_feedback_channel = "fofb"
        [epics.auxiliary]
        current = { pv = "SR:C03-BI{DCCT:1}I:Real-I", scale = 1e-3, stale_after = 10.0 }
        fofb = { pv = "SR:SIM{Ring}Tick-I" }
        """
    )
    with Service(tmp_path / "data", "sim", "--start", "open", "--config", config) as service:
        with pytest.raises(ControlError, match="the fast feedback is closed"):
            ask(service.data, {"command": "close"})
        assert service.status()["state"] == "OPEN"
