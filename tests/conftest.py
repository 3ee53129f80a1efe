"""For every test: EPICS on loopback, nothing beyond loopback, nothing left behind."""

import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
import typer.main
from hypothesis import settings
from left_behind import watch
from order import begin_elsewhere, sort_tests
from times import measure_times, pytest_addoption

__all__ = ["pytest_addoption"]

_LOOPBACK_EPICS = {
    "EPICS_CA_ADDR_LIST": "127.0.0.1",
    "EPICS_CA_AUTO_ADDR_LIST": "NO",
    "EPICS_CA_SERVER_PORT": "11999",  # nobody; a test that needs a server names its port
    "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
    "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_BEACON_PORT": "11998",
    "EPICS_PVA_ADDR_LIST": "127.0.0.1",
    "EPICS_PVA_AUTO_ADDR_LIST": "NO",
    "EPICS_PVAS_INTF_ADDR_LIST": "127.0.0.1",
}


def _force_environment() -> None:
    """Before any module is imported: libca and caproto read some of it only once."""
    for name in tuple(os.environ):
        if name.startswith(("EPICS_", "ORBITFB_")):
            del os.environ[name]
    os.environ.update(_LOOPBACK_EPICS)
    # As the program itself does: small matrices lose more by waiting for threads than they gain.
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    # Hundreds of processes import the package; without bytecode each compiles it for half a second.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False


_force_environment()

# A command line makes all its commands at each call, which takes 40 ms; here they are made once.
typer.main.get_command = cache(typer.main.get_command)

# A busy computer is no bug: how long an example takes is never an assertion.
settings.register_profile("orbitfb", deadline=None)
settings.load_profile("orbitfb")


def pytest_configure(config: pytest.Config) -> None:
    """Measure what tests take, if that is asked for; tell a worker where to begin."""
    measure_times(config)
    begin_elsewhere(config)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put them in the order in which they run."""
    sort_tests(items)


@pytest.fixture(scope="session", autouse=True)
def _own_runtime_directory() -> Iterator[None]:
    """Keep locks and control sockets of the tests away from those of the user."""
    directory = tempfile.mkdtemp(prefix="orbitfb-test-")
    os.environ["XDG_RUNTIME_DIR"] = directory
    yield
    shutil.rmtree(directory)


def _is_loopback(address: object) -> bool:
    if not isinstance(address, tuple):  # a Unix socket
        return True
    host = str(address[0])
    return host in ("", "localhost", "::1", "0.0.0.0") or host.startswith("127.")


def _loopback_only(original: Callable[..., object]) -> Callable[..., object]:
    def guarded(self: socket.socket, *arguments: object) -> object:
        address = arguments[-1]
        if not _is_loopback(address):
            raise AssertionError(f"a test tried to reach {address!r}, beyond loopback")
        return original(self, *arguments)

    return guarded


@pytest.fixture(scope="session", autouse=True)
def _stay_on_loopback() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("connect", "connect_ex", "sendto"):
            patch.setattr(socket.socket, name, _loopback_only(getattr(socket.socket, name)))
        yield


@pytest.fixture(scope="module", autouse=True)
def _module_leaves_nothing_behind() -> Iterator[None]:
    yield from watch()


@pytest.fixture(autouse=True)
def _test_leaves_nothing_behind() -> Iterator[None]:
    yield from watch()


@pytest.fixture
def repository() -> Path:
    """The root of the repository."""
    return Path(__file__).parents[1]
