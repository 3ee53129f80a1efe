"""Rings and example effects."""

import pytest
from example_kinds import KINDS

from orbitfb.effects import registry
from orbitfb.effects.build import layout_of
from orbitfb.physics.places import Ring


@pytest.fixture(scope="session")
def ring():
    return Ring.load()


@pytest.fixture(scope="session")
def layout(ring):
    return layout_of(ring, "x", 0.1)


@pytest.fixture(scope="session")
def both_planes(ring):
    return layout_of(ring, "xy", 0.1)


@pytest.fixture
def examples(monkeypatch):
    monkeypatch.setattr(registry, "all_effects", lambda: KINDS)
    return KINDS
