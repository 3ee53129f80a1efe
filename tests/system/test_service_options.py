"""Options that make no sense are refused before anything starts, and nothing is written."""

import socket
from pathlib import Path

import pytest
from service_process import as_process, refused

from orbitfb.app.setup.startup import find_ring
from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError

pytestmark = pytest.mark.system

RUN = ("run", "--metrics-port", 0, "--duration", 1)
SIM = (*RUN, "--ioc", "sim", "--port", 0)

OPTIONS = {
    "negative duration": (
        (*SIM, "--duration", -1),
        "--duration -1: give a time above 0 s, or leave it out",
    ),
    "no duration": (
        (*SIM, "--duration", 0),
        "--duration 0: give a time above 0 s, or leave it out",
    ),
    "duration without end": (
        (*SIM, "--duration", "inf"),
        "--duration inf: give a time above 0 s, or leave it out",
    ),
    "duration nan": (
        (*SIM, "--duration", "nan"),
        "--duration nan: give a time above 0 s, or leave it out",
    ),
    "port beyond all ports": (
        (*RUN, "--ioc", "host:99999"),
        "--ioc host:99999: '99999' is no port for Channel Access; give one from 5001 to 65535 "
        "(libca would use 5064, the usual one of a machine, for any other)",
    ),
    "port that libca does not take": (
        (*RUN, "--ioc", "127.0.0.1:5000"),
        "--ioc 127.0.0.1:5000: '5000' is no port for Channel Access; give one from 5001 to 65535 "
        "(libca would use 5064, the usual one of a machine, for any other)",
    ),
    "no port after the colon": (
        (*RUN, "--ioc", "127.0.0.1:"),
        "--ioc 127.0.0.1:: give sim, env, config, HOST or HOST:PORT",
    ),
    "no address": ((*RUN, "--ioc", ""), "--ioc : give sim, env, config, HOST or HOST:PORT"),
    "host that is no name": (
        (*RUN, "--ioc", "no..host"),
        "the host 'no..host', where PVs are to be searched for, is not known; give a name that "
        "resolves, or an IPv4 address",
    ),
    "state in which no loop starts": (
        (*SIM, "--start", "held"),
        "--start held: choose open, shadow or closed",
    ),
    "no rate": (
        (*SIM, "--rate", 0),
        "the configuration is refused:\n"
        "  --rate: Input should be greater than 0, got 0.0 (key loop.rate_hz)\n"
        "`orbitfb config show` prints every key with its value and meaning.",
    ),
    "unknown drift": (
        (*SIM, "--drift", "papr"),
        "the configuration is refused:\n  --drift: Input should be 'none', 'paper', "
        "'mild' or 'strong', got 'papr' (key plant.drift.preset)\n"
        "`orbitfb config show` prints every key with its value and meaning.",
    ),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_bad_option(name: str, tmp_path: Path):
    arguments, message = OPTIONS[name]
    assert refused(*arguments, "--data", tmp_path / "data") == message
    assert list(tmp_path.iterdir()) == []


def test_nonsense_is_no_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In process, with a resolver of our own: no name server is asked."""

    def resolve(host: str) -> str:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "gethostbyname", resolve)
    with pytest.raises(ConfigError, match=r"the host 'nonsense', where PVs .* is not known"):
        find_ring(load_config(environment={}), "nonsense")


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        (
            {"EPICS_CA_SERVER_PORT": "many"},
            "environment variable EPICS_CA_SERVER_PORT: 'many' is no port for Channel Access; ",
        ),
        (
            {"EPICS_CA_ADDR_LIST": ""},
            "--ioc env: there is nowhere to search for PVs: the address list and the name servers "
            "are empty and EPICS_CA_AUTO_ADDR_LIST is NO; set EPICS_CA_ADDR_LIST, "
            "EPICS_CA_NAME_SERVERS, epics.address_list or epics.name_servers",
        ),
    ],
)
def test_bad_epics_environment(environment: dict[str, str], message: str, tmp_path: Path):
    said = refused(*RUN, "--ioc", "env", "--data", tmp_path / "data", **environment)
    assert said.startswith(message)
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_that_knows_no_greek_gets_question_marks():
    done = as_process("config", "show", PYTHONIOENCODING="ascii")
    assert done.returncode == 0
    assert "# Tikhonov ?, compared with" in done.stdout
