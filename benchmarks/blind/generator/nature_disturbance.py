"""What moves the orbit or its sampling, as nature makes it."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_optics import Motion
from benchmarks.blind.generator.nature_sensor import sign
from benchmarks.blind.generator.rings import Array
from orbitfb.physics.places import Plane

Rng = np.random.Generator


def source(case: Conditions, rng: Rng) -> tuple[str, Plane, Array]:
    """A quadrupole that shakes: its name, its plane, the orbit per kick (n,) [m/rad]."""
    quads = case.lattice.quads
    which = int(rng.integers(len(quads)))
    plane = case.all_planes[int(rng.integers(len(case.all_planes)))]
    shape = case.kick_orbit(quads[[which]], plane)[:, 0]
    return case.lattice.ring.names("QUAD")[which], plane, shape


@kind("periodic-disturbance", "disturbance", onset="start")
def periodic(case: Conditions, rng: Rng) -> Draft:
    name, _, shape = source(case, rng)
    frequency, phase = rng.uniform(0.01, 0.49) / case.period, rng.uniform(0, 2 * np.pi)
    time = (np.arange(case.rows) - case.warm) * case.period
    wave = np.sin(2 * np.pi * frequency * time + phase)
    return Draft(
        [name],
        lambda s: Motion(s * np.outer(wave, shape)),
        lambda s: {
            "cosine": (s * float(np.sin(phase)), "rad"),
            "sine": (s * float(np.cos(phase)), "rad"),
            "frequency": (frequency, "Hz"),
        },
        3e-9,
        1e-5,
    )


class Shakier(Nature):
    """The ground moves more from the onset on: further steps of the same quadrupoles."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def bind(self, case: Conditions, rng: Rng) -> None:
        added = np.sqrt(max(self.factor**2 - 1, 0))
        pieces = []
        for plane in case.all_planes:
            kicks = case.quad_kicks[plane]
            steps = np.diff(kicks, axis=0, prepend=kicks[:1])
            more = added * steps * rng.standard_normal(steps.shape)
            orbit = case.lattice.response(case.bpms, case.lattice.quads, plane)
            pieces.append(more @ orbit.T)
        self.steps = np.hstack(pieces)
        self.steps[: self.start] = 0

    def motion(self) -> Array:
        return np.cumsum(self.steps, axis=0)


@kind("ground-motion-level", "disturbance", onset="inside")
def ground_motion_level(case: Conditions, rng: Rng) -> Draft:
    return Draft(
        [],
        lambda s: Shakier(float(np.sqrt(1 + s**2))),
        lambda s: {"factor": (float(np.sqrt(1 + s**2)), "1")},
        0.7,
        30.0,
        law="random",
    )


@kind("thermal-drift", "disturbance", onset="start")
def thermal_drift(case: Conditions, rng: Rng) -> Draft:
    name, _, shape = source(case, rng)
    way, time = sign(rng), np.arange(case.rows) * case.period
    slow = time[-1] * rng.uniform(2, 6)
    course = slow * (1 - np.exp(-time / slow))
    return Draft(
        [name],
        lambda s: Motion(way * s * np.outer(course, shape)),
        lambda s: {"rate": (way * s, "rad/s"), "tau": (slow, "s")},
        1e-9,
        1e-5,
    )


@kind("local-kick", "disturbance", onset="inside")
def local_kick(case: Conditions, rng: Rng) -> Draft:
    name, _, shape = source(case, rng)
    way = sign(rng)
    return Draft(
        [name],
        lambda s: Motion(way * s * np.tile(shape, (case.rows, 1))),
        lambda s: {"kick": (way * s, "rad")},
        1e-7,
        1e-4,
    )


@kind("insertion-device", "disturbance", onset="start")
def insertion_device(case: Conditions, rng: Rng) -> Draft:
    """Kicks at the ends of a straight section, as its gap goes to and fro."""
    ring = case.lattice.ring
    quads = case.lattice.quads
    straights = np.flatnonzero(
        np.diff(ring.table.s[quads]) > 0.8 * np.diff(ring.table.s[quads]).max()
    )
    first = int(rng.choice(straights))
    plane = case.all_planes[int(rng.integers(len(case.all_planes)))]
    both = case.kick_orbit(quads[[first, first + 1]], plane)
    # A dipole error at one end, or at both.
    way, ratio = sign(rng), rng.choice([0.0, rng.uniform(-0.9, -0.3)])
    shape = both[:, 0] + ratio * both[:, 1]
    open_gap, period = case.gap.max(), rng.uniform(20e-3, 60e-3)
    # Fields grow exponentially as the gap closes.
    course = np.exp(-np.pi * case.gap / period) - np.exp(-np.pi * open_gap / period)
    course /= course.max()
    names = ring.names("QUAD")
    return Draft(
        [names[first], names[first + 1]] if ratio else [names[first]],
        lambda s: Motion(way * s * np.outer(course, shape)),
        lambda s: {"kick_when_closed": (way * s, "rad")},
        5e-7,
        1e-4,
    )


@kind("telegraph", "disturbance", onset="start")
def telegraph(case: Conditions, rng: Rng) -> Draft:
    name, _, shape = source(case, rng)
    stay = rng.uniform(20, 120)
    flips = rng.random(case.rows) < 1 / stay
    state = np.where(np.cumsum(flips) % 2 == 0, -0.5, 0.5)
    return Draft(
        [name],
        lambda s: Motion(s * np.outer(state, shape)),
        lambda s: {"kick": (s / 2, "rad"), "probability": (1 / stay, "1")},
        3e-8,
        1e-5,
        law="random",  # nobody knows when it jumps
    )


class Jitter(Nature):
    """Readings a little early, while the orbit is still on its way; late ones see no difference."""

    def __init__(self, spread: float) -> None:
        self.spread = spread

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.early, self.before = rng.standard_normal(case.rows), None
        self.noise_of = case.noise

    def bend(self, row: int, orbit: Array, currents: Array) -> Array:
        before = orbit if self.before is None else self.before
        self.before = orbit
        share = min(max(self.spread * self.early[row], 0.0), 1.0)
        return orbit + share * (before - orbit)


@kind("clock-jitter", "timing", onset="start")
def clock_jitter(case: Conditions, rng: Rng) -> Draft:
    return Draft(
        [],
        lambda s: Jitter(s),
        lambda s: {"rms": (s * case.period / np.sqrt(2), "s")},  # early ones only: half of them
        0.05,
        0.6,
        law="random",
    )


class Repeated(Nature):
    """Now and then the readings of the tick before are told once more, all together."""

    def __init__(self, chance: float) -> None:
        self.chance = chance

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.luck, self.memory = rng.random(case.rows), None

    def read(self, row: int, seen: Array) -> Array:
        if self.memory is None or self.luck[row] >= self.chance:
            self.memory = seen
        return self.memory


@kind("missed-read", "timing", onset="start")
def missed_read(case: Conditions, rng: Rng) -> Draft:
    chance = rng.uniform(0.005, 0.03)
    return Draft(
        [],
        lambda s: Repeated(chance),
        lambda s: {"probability": (chance, "1")},
        0.0,
        0.0,
    )
