"""A simulated ring in process to measure, with faults on request, and how to measure it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.measure.column import Table
from orbitfb.measure.journal import Journal
from orbitfb.measure.judging import judge
from orbitfb.measure.measurement import Measurement, Teller
from orbitfb.measure.settings import MeasureSettings
from orbitfb.measure.watch import Watch
from orbitfb.physics.drift import DriftSettings
from orbitfb.physics.effect import Effect
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.physics.response import response
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

RING = Ring.load()
NOMINAL = response(RING, "x")
CHANNELS = RING.channels("x")
MOVED = DriftSettings(preset="strong", ticks=1)
"""A ring that is not what the optics say: from its second orbit on it has other optics."""
QUIET = PlantSettings(bpm_noise_rms=0, ground_motion_rms=0, initial_orbit_rms=0, drift=MOVED)
NOISY = PlantSettings(bpm_noise_rms=0.2e-6, ground_motion_rms=0, initial_orbit_rms=0, drift=MOVED)
NEVER_FROZEN = InterlockSettings(frozen_ticks=0)


class Recorder(PlantMachine):
    """Keeps what is written, and lets a test do something at a tick."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.writes = [self.setpoints()]
        self.at = {}

    def write(self, setpoints, which=None):
        applied = super().write(setpoints, which)
        self.writes.append(setpoints.copy())
        return applied

    def read(self, timeout):
        for tick in [tick for tick in self.at if tick <= self.plant.tick]:
            self.at.pop(tick)(self)
        return super().read(timeout)


class Saturating(Effect):
    """A corrector whose current stops at a limit."""

    def __init__(self, corrector, limit):
        self.corrector, self.limit = corrector, limit

    def actuate(self, setpoints, tick):
        currents = setpoints.copy()
        currents[self.corrector] = np.clip(currents[self.corrector], -self.limit, self.limit)
        return currents


class Unplugged(Effect):
    """A corrector whose supply follows, but whose magnet does nothing."""

    def __init__(self, corrector):
        self.corrector = corrector

    def respond(self, orbit, currents, tick):
        return orbit - np.multiply.outer(NOMINAL[:, self.corrector], currents[self.corrector])


class Stuck(Effect):
    """A BPM that reads a constant; others go on."""

    def __init__(self, bpm):
        self.bpm = bpm

    def sense(self, orbit, tick):
        reading = orbit.copy()
        reading[self.bpm] = 1e-4
        return reading


class Ramp(Effect):
    """A linear drift of the orbit."""

    def __init__(self, per_tick):
        self.per_tick = per_tick

    def disturb(self, orbit, tick):
        return orbit + self.per_tick * tick


class Lagging(Effect):
    """A corrector that goes to its setpoint by a part of the way per tick."""

    def __init__(self, corrector, part):
        self.corrector, self.part, self.now = corrector, part, 0.0

    def actuate(self, setpoints, tick):
        currents = setpoints.copy()
        self.now += self.part * (currents[self.corrector] - self.now)
        currents[self.corrector] = self.now
        return currents


class Late(Effect):
    """Now and then a whole write comes a tick too late."""

    def __init__(self, part):
        self.part, self.random, self.before = part, np.random.default_rng(4), None

    def actuate(self, setpoints, tick):
        late = self.before is not None and self.random.uniform() < self.part
        shown, self.before = (self.before if late else setpoints), setpoints.copy()
        return shown.copy()


class Told(Teller):
    """Keeps what it is told."""

    def __init__(self, bench):
        self.bench = bench

    def begin(self, orbits, done, total):
        self.bench.planned = orbits

    def progress(self, done, total):
        self.bench.told.append((done, total))

    def played(self, share):
        self.bench.played.append(share)


@dataclass
class Bench:
    """A ring, and everything that a measurement of it needs."""

    directory: Path
    plant_settings: PlantSettings = QUIET
    effects: tuple = ()
    settings: MeasureSettings = field(default_factory=MeasureSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    interlocks: InterlockSettings = NEVER_FROZEN
    correctors: tuple = (3, 40, 41, 100, 179)
    seed: int = 1

    def __post_init__(self):
        self.clock = ManualClock()
        plant = Plant(RING, "x", self.plant_settings, self.seed, self.effects)
        self.machine = Recorder(plant, self.clock)
        self.machine.read(1.0)
        self.base = np.random.default_rng(2).uniform(-0.3, 0.3, 180)
        self.machine.write(self.base)
        self.machine.read(1.0)
        self.machine.writes = [self.base.copy()]
        self.counting = np.ones(180, dtype=np.bool_)
        self.movable = np.zeros(180, dtype=np.bool_)
        self.movable[list(self.correctors)] = True
        self.journal = Journal(self.directory / "measurement", CHANNELS, "here")
        self.stop = False
        self.told, self.played, self.planned = [], [], 0

    @property
    def true(self):
        """The response that the ring has, from the plant, shape (180, k)."""
        return self.machine.plant.response[:, list(self.correctors)]

    def run(self, table=None, bounds=None, **settings):
        """Measure."""
        asked = self.settings.model_copy(update=settings)
        watch = Watch(self.machine, asked, self.interlocks, self.counting, 0.5, lambda: self.stop)
        measurement = Measurement(
            self.machine,
            NOMINAL,
            asked,
            self.limits,
            watch,
            self.movable,
            self.journal,
            self.clock,
            bounds=bounds,
            teller=Told(self),
        )
        return measurement.run(table or Table.empty(180, 180))

    def judged(self, result):
        """Say what is wrong with it."""
        return judge(result.table, NOMINAL, CHANNELS, self.settings, self.counting)

    def measured(self, result):
        """Columns of the correctors, shape (180, k)."""
        return result.table.response[:, list(self.correctors)]
