"""Programs of Debian that these tests need; what is not installed is skipped with the reason."""

import shutil
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is here: `make nightly` does it."""
    for item in items:
        if item.path.parent == HERE:
            item.add_marker(pytest.mark.nightly)


def program(name: str, package: str) -> str:
    """Return the path of a program, or skip the test."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"no {name}: apt-get install {package} (make nightly does it as root)")
    return found


@pytest.fixture(scope="session")
def promtool_program() -> str:
    """Prometheus' own checker."""
    return program("promtool", "prometheus")


@pytest.fixture(scope="session")
def prometheus_program() -> str:
    """Prometheus."""
    return program("prometheus", "prometheus")


@pytest.fixture(scope="session")
def alertmanager_program() -> str:
    """Alertmanager, as Debian calls it."""
    return program("prometheus-alertmanager", "prometheus-alertmanager")
