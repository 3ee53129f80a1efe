"""Fixtures of the tests that start real processes."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from forked import fork_server
from service_process import Ioc


@pytest.fixture(scope="session", autouse=True)
def _starts_are_forks(_own_runtime_directory: None) -> Iterator[None]:
    """Start the program quickly."""
    with fork_server():
        yield


@pytest.fixture
def ioc(tmp_path: Path) -> Iterator[Ioc]:
    """A simulated ring, `orbitfb ioc`, on a free port."""
    with Ioc(tmp_path) as process:
        yield process


@pytest.fixture
def taken_port() -> Iterator[int]:
    """A TCP port of loopback on which somebody listens."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


@pytest.fixture
def dead_port() -> Iterator[int]:
    """A port of loopback that nobody answers and nobody can take."""
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        udp.bind(tcp.getsockname())
        yield tcp.getsockname()[1]
