"""What was away is asked for everything before it is written to again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from base_ioc_process import BaseIoc
from service_process import CHANNELS, Ioc, Service, setpoints, transitions

pytestmark = pytest.mark.system

QUIET = """
[learn]
enabled = false
[diagnose.live]
enabled = false
[web]
enabled = false
[lease]
pv = ""
"""


def test_the_limits_of_a_server_that_comes_back_with_narrower_ones_hold(tmp_path: Path):
    config, narrow = tmp_path / "c.toml", tmp_path / "narrow.toml"
    config.write_text(QUIET + "[epics]\nreconnect_period = 0.5\n")
    narrow.write_text("[sim]\ncorrector_limit = 0.01\n")
    with Ioc(tmp_path) as ioc:
        port = ioc.port
        options = ("--start", "closed", "--config", config)
        with Service(tmp_path / "data", f"127.0.0.1:{port}", *options) as service:
            service.wait_below(1.0)
            ioc.kill()
            service.wait_state("HELD", 5.0)
            with Ioc(tmp_path, port, ("--config", narrow)) as again:
                service.wait_status(
                    "limits",
                    lambda its: "at their drive limits" in its["reason"],
                    20.0,
                )
                assert service.status()["state"] in ("CLOSED", "TRIPPED")
                assert np.abs(setpoints(port)).max() <= 0.01
                again.kill()


@pytest.mark.nightly
def test_a_corrector_whose_setpoint_is_away_is_left_out_and_read_when_it_is_back(tmp_path: Path):
    """It has an IOC of its own, which is restarted with all its setpoints at 0."""
    index = 90
    keys = ("correctors", "setpoint_pvs", "readback_pvs")
    own = replace(CHANNELS, orbit_pvs=(), **{k: (getattr(CHANNELS, k)[index],) for k in keys})
    rest = replace(CHANNELS, **{k: tuple(np.delete(getattr(CHANNELS, k), index)) for k in keys})
    with BaseIoc(rest, 10.0, plant_seed=3) as big, BaseIoc(own, 10.0, auxiliary={}) as small:
        config = tmp_path / "c.toml"
        addresses = f"127.0.0.1:{big.port} 127.0.0.1:{small.port}"
        config.write_text(f'{QUIET}[epics]\naddress_list = "{addresses}"\nreconnect_period = 0.5\n')
        options = ("--start", "closed", "--config", config)
        with Service(tmp_path / "data", "config", *options) as service:
            service.wait_below(5.0, 30.0)
            small.kill()
            named = f"1 correctors do not follow and are left out: {own.correctors[0]}"
            left_out = service.wait_status(
                "left out",
                lambda its: its["state"] == "CLOSED" and named in its["reason"],
                15.0,
            )
            service.wait_status("ticks", lambda its: its["ticks"] > left_out["ticks"] + 10, 15.0)
            assert service.status()["state"] == "CLOSED"
            small.start()
            back = service.wait_status(
                "all setpoints",
                lambda its: (
                    service.metric('orbitfb_channel_access_channels_connected{kind="setpoint"}')
                    == 180
                ),
                15.0,
            )
            service.wait_status(
                "ticks",
                lambda its: its["state"] == "CLOSED" and its["ticks"] > back["ticks"] + 15,
                20.0,
            )
            assert named in service.status()["reason"]  # until the loop is opened
            service.stop()
    archived = transitions(service.data)
    own_setpoint = archived.setpoints[:, index]
    assert np.abs(archived.applied[-10:, index]).max() == 0.0
    assert own_setpoint[-1] == 0.0  # as the restarted IOC says, not as it was
    assert np.abs(archived.applied).max() <= 2.0
    written = np.isfinite(archived.written)
    assert written[-10:].all()
