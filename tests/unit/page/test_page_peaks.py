"""The page hears of every tick of a loop that runs, not of those alone that it asks about."""

import math

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import TickRecord
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.page.peaks import Peaks
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


def test_a_subscriber_that_comes_later_hears_every_tick_from_then_on():
    clock, plant = ManualClock(), Plant(Ring.load(), "x", seed=0)
    runner = Runner(
        PlantMachine(plant, clock),
        PolicySlot(SvdPolicy(plant.nominal_response, SvdSettings())),
        LoopSettings(),
        LimitSettings(),
        InterlockSettings(),
        np.zeros(180),
        clock,
        random=np.random.default_rng(1),
    )
    runner.step()
    peaks = Peaks("x")
    heard: list[TickRecord] = []
    runner.subscribe(peaks)
    runner.subscribe(lambda record: heard.append(record))
    for _ in range(5):
        runner.step()
    assert len(heard) == 5
    orbits = [record.reading.orbit for record in heard if record.reading is not None]
    largest = max(math.sqrt(np.mean(its.position[its.valid] ** 2)) for its in orbits)
    assert peaks.since(clock.monotonic()) == pytest.approx({"x": largest})
