"""What a setpoint PV of the panel shows when the service is late."""

import asyncio

import pytest

from orbitfb.core.errors import ControlError
from orbitfb.panel.channels import Origin
from orbitfb.panel.job import PanelJob
from orbitfb.panel.server import Panel

ORIGIN = Origin("op", "127.0.0.1")


class Service:
    """Answers the panel; `late`: it does what it is told after the panel has given up."""

    def __init__(self):
        self.gain, self.late, self.asked = 0.5, False, None

    def ask(self, request, timeout):
        if request["command"] == "panel":
            return {"alive": True, "figures": {"GainX-RB": self.gain}}
        if self.late:
            self.asked = request["value"]
            raise ControlError("the service does not answer in time")
        self.gain = request["value"]
        return {}


@pytest.fixture
def service():
    return Service()


@pytest.fixture
def panel(service, tmp_path):
    job = PanelJob(data_directory=tmp_path, panel={}, planes="x", bpms=4, correctors=4)
    panel = Panel(job, service.ask)
    yield panel
    panel.close()


def test_a_write_that_the_service_obeys_after_its_time_shows_in_the_setpoint(panel, service):
    channel = panel._channels["GainX-SP"]

    async def story():
        await panel.look()
        assert channel.value == 0.5
        service.late = True
        with pytest.raises(ControlError):
            await panel.obey(channel.pv, 0.8, ORIGIN)
        await panel.look()
        assert channel.value == 0.5
        service.gain = service.asked
        await panel.look()
        assert channel.value == 0.8
        service.late = False
        await panel.obey(channel.pv, 0.9, ORIGIN)
        service.gain = 0.3  # set elsewhere: the setpoint is what was written here
        await panel.look()
        assert channel.value != 0.3

    asyncio.run(story())
