"""Where PVs over pvAccess are searched for, and that nobody comes to a machine by accident."""

import pytest

from orbitfb.app.setup.production_guard import check_live, pvs_of
from orbitfb.app.setup.startup import find_ring, servers_of
from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError, RingError
from orbitfb.core.signals import Channels
from orbitfb.epics.pva.provider import pva_client, search_of
from orbitfb.epics.settings import EpicsSettings, PvaSettings
from orbitfb.sim.layout import check_served
from orbitfb.sim.settings import SimSettings

OVER_PVA = ("pva://MY:ORBIT.[0]",)
MACHINE, SIMULATED = 5076, 15076


def test_hosts_are_those_of_channel_access_unless_they_are_named():
    settings = EpicsSettings(address_list="10.0.0.1:5064 10.0.0.2", circuit_timeout=3.0)
    assert search_of(settings) == {
        "EPICS_PVA_ADDR_LIST": "10.0.0.1 10.0.0.2",
        "EPICS_PVA_AUTO_ADDR_LIST": "NO",
        "EPICS_PVA_NAME_SERVERS": "",
        "EPICS_PVA_BROADCAST_PORT": str(MACHINE),
        "EPICS_PVA_CONN_TMO": "3.0",
    }
    own = PvaSettings(address_list="10.0.0.9", name_servers="10.0.0.8:5075", port=5080)
    found = search_of(settings.model_copy(update={"pva": own}))
    assert (found["EPICS_PVA_ADDR_LIST"], found["EPICS_PVA_BROADCAST_PORT"]) == ("10.0.0.9", "5080")
    assert found["EPICS_PVA_NAME_SERVERS"] == "10.0.0.8:5075"


def test_without_such_pvs_there_is_no_client():
    assert pva_client(EpicsSettings(), ("MY:ORBIT.[0]", "")) is None


def test_a_host_alone_is_that_of_a_simulated_ring():
    assert find_ring(load_config(), "127.0.0.1").pva.port == SIMULATED
    assert find_ring(load_config(), "127.0.0.1:15064").pva.port == MACHINE


def test_the_environment_says_where(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("EPICS_CA_ADDR_LIST", "127.0.0.1")
    monkeypatch.delenv("EPICS_CA_SERVER_PORT", raising=False)
    monkeypatch.delenv("EPICS_CA_NAME_SERVERS", raising=False)
    monkeypatch.setenv("EPICS_PVA_ADDR_LIST", "127.0.0.2")
    monkeypatch.setenv("EPICS_PVA_BROADCAST_PORT", "15099")
    found = find_ring(load_config(), "env")
    assert (found.pva_addresses, found.pva.port) == ("127.0.0.2", 15099)
    assert servers_of(found)[-2:] == ["127.0.0.1:5064", "127.0.0.2:15099"]
    monkeypatch.setenv("EPICS_PVA_ADDR_LIST", "127.0.0.1")
    assert servers_of(find_ring(load_config(), "env"))[-2:] == ["127.0.0.1:5064", "127.0.0.1:15099"]
    monkeypatch.setenv("EPICS_PVA_BROADCAST_PORT", "0")
    with pytest.raises(ConfigError, match="EPICS_PVA_BROADCAST_PORT: '0' is no port"):
        find_ring(load_config(), "env")


def test_the_port_of_machines_is_refused_unless_it_is_meant():
    epics = find_ring(load_config(), "127.0.0.1:15064")
    check_live(epics, "127.0.0.1:15064", None, False, pvs_of(load_config()))
    with pytest.raises(ConfigError, match=f"searched for at port {MACHINE}.*give --live"):
        check_live(epics, "127.0.0.1:15064", None, False, OVER_PVA)
    check_live(epics, "127.0.0.1:15064", None, True, OVER_PVA)
    other = epics.model_copy(update={"pva": PvaSettings(port=SIMULATED)})
    check_live(other, "127.0.0.1:15064", None, False, OVER_PVA)


def test_the_simulated_ring_serves_no_scalars_over_pvaccess():
    channels = Channels("x", ("B",), ("C",), ("pva://B",), ("C:SP",), ("",))
    with pytest.raises(RingError, match=r"pva://B is a scalar.*pva://B\.\[0\]"):
        check_served(channels, SimSettings())
