"""A policy store in a directory of its own."""

import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.policies.store.directory import PolicyStore


@pytest.fixture
def store(tmp_path):
    return PolicyStore(tmp_path / "policies", ManualClock())
