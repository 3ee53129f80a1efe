"""Optics that are not those of the model: wrong quadrupoles, sextupoles, energy, coupling."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_sensor import sign
from benchmarks.blind.generator.rings import Array, Index
from orbitfb.physics.places import Plane

Rng = np.random.Generator
BOTH: tuple[Plane, ...] = ("x", "y")


class Gradients(Nature):
    """Further gradient errors at given rows: the closed orbit is solved anew at each."""

    def __init__(self, knots: list[tuple[int, Array]]) -> None:
        self.knots = knots

    def extra_errors(self) -> list[tuple[int, Array]]:
        return self.knots


@kind("quadrupole-gradient", "optics")
def quadrupole_gradient(case: Conditions, rng: Rng) -> Draft:
    quads, way = case.lattice.quads, sign(rng)
    quad = int(rng.integers(len(quads)))
    unit = np.eye(len(quads))[quad] * way
    return Draft(
        [case.lattice.ring.names("QUAD")[quad]],
        lambda s: Gradients([(0, s * unit)]),
        lambda s: {"gradient": (way * s, "1/m")},
        2e-3,
        0.05,
    )


def tune_direction(case: Conditions, plane: Plane) -> Array:
    """Relative errors of focusing and defocusing families that shift one tune, per unit of it."""
    ring, quads = case.lattice.ring, case.lattice.quads
    strength, beta = ring.strength("QUAD"), ring.table.beta[:, quads]
    families = np.stack([np.where(strength > 0, strength, 0), np.where(strength < 0, strength, 0)])
    shift = np.stack([beta[0] @ families.T, -beta[1] @ families.T]) / (4 * np.pi)
    wanted = np.array([1.0, 0.0]) if plane == "x" else np.array([0.0, 1.0])
    return np.asarray(np.linalg.solve(shift, wanted) @ families, dtype=np.float64)


@kind("tune-shift", "optics")
def tune_shift(case: Conditions, rng: Rng) -> Draft:
    plane, way = case.all_planes[int(rng.integers(len(case.all_planes)))], sign(rng)
    unit = tune_direction(case, plane) * way
    return Draft(
        [],
        lambda s: Gradients([(0, s * unit)]),
        lambda s: {f"dnu_{plane}": (way * s, "1")},
        0.004,
        0.05,
    )


def growing(case: Conditions, errors: Array) -> Gradients:
    """Errors that grow from nothing to the given ones; the orbit is solved 25 times on the way."""
    rows = np.linspace(0, case.rows, 26).astype(int).tolist()
    return Gradients([(row, row / case.rows * errors) for row in rows])


@kind("optics-drift", "optics", onset="start")
def optics_drift(case: Conditions, rng: Rng) -> Draft:
    """A family of supplies that drifts apart, or a single one."""
    strength = case.lattice.ring.strength("QUAD")
    length = case.rows * case.period
    places: list[str] = []
    if rng.random() < 0.5:
        quad = int(rng.integers(len(strength)))
        places = [case.lattice.ring.names("QUAD")[quad]]
        relative = np.eye(len(strength))[quad] * sign(rng)
    else:
        relative = rng.standard_normal(len(strength))
        beta = case.lattice.ring.table.beta[:, case.lattice.quads]
        # A running ring holds its tunes.
        relative -= np.linalg.pinv(beta * strength) @ (beta * strength @ relative)
    rate = float(relative.sum() if places else np.std(relative)) / length
    return Draft(
        places,
        lambda s: growing(case, s * relative * strength),
        lambda s: {"rate": (s * rate, "1/s")},
        0.01,
        0.2,
    )


@kind("tune-drift", "optics", onset="start")
def tune_drift(case: Conditions, rng: Rng) -> Draft:
    plane, way = case.all_planes[int(rng.integers(len(case.all_planes)))], sign(rng)
    unit = tune_direction(case, plane) * way
    length = case.rows * case.period
    return Draft(
        [],
        lambda s: growing(case, s * unit),
        lambda s: {f"rate_{plane}": (way * s / length, "1/s")},
        0.004,
        0.05,
    )


class Sextupole(Nature):
    """One sextupole that the model does not have; its kick moves the orbit in itself too."""

    def __init__(self, place: Index, strength: float) -> None:
        self.place, self.strength = place, strength

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.case, planes = case, case.all_planes
        self.shape = {p: case.kick_orbit(self.place, p)[:, 0] for p in planes}
        self.reach = {p: case.orbit_at(self.place, p)[0] for p in planes}
        self.ground = {p: case.moved(self.place, p)[:, 0] for p in planes}
        self.own = {
            p: float(case.lattice.response(self.place, self.place, p)[0, 0]) for p in planes
        }

    def bend(self, row: int, orbit: Array, currents: Array) -> Array:
        start = {p: self.reach[p] @ currents + self.ground[p][row] for p in self.reach}
        here, kick = dict(start), {}
        for _ in range(20):
            x, y = here.get("x", 0.0), here.get("y", 0.0)
            kick = {"x": -self.strength * (x * x - y * y), "y": 2 * self.strength * x * y}
            here = {p: start[p] + self.own[p] * kick[p] for p in start}
        for p in start:
            orbit = orbit + self.shape[p] * kick[p]
        return orbit


@kind("sextupole", "optics", planes="x")
def sextupole(case: Conditions, rng: Rng) -> Draft:
    places, way = case.lattice.ring.places("SEXT"), sign(rng)
    which = int(rng.integers(len(places)))
    return Draft(
        [case.lattice.ring.names("SEXT")[which]],
        lambda s: Sextupole(places[[which]], way * s),
        lambda s: {"strength": (way * s, "1/m2")},
        3.0,
        400.0,
    )


class Motion(Nature):
    """An orbit that comes whatever the loop does."""

    def __init__(self, course: Array) -> None:
        self.course = course

    def motion(self) -> Array:
        return self.course


@kind("energy-ramp", "optics", planes="x", onset="start")
def energy_ramp(case: Conditions, rng: Rng) -> Draft:
    time, way = np.arange(case.rows) * case.period, sign(rng)
    tide = time[-1] * rng.uniform(4, 10)  # a piece of a slow wave, as the tide's
    course = tide / (2 * np.pi) * np.sin(2 * np.pi * time / tide)
    return Draft(
        [],
        lambda s: Motion(way * s * np.outer(course, case.dispersion)),
        lambda s: {"rate": (way * s * float((course[-1] - course[0]) / time[-1]), "1/s")},
        1e-7,
        1e-3,
    )


@kind("energy-drift", "optics", planes="x", onset="start")
def energy_drift(case: Conditions, rng: Rng) -> Draft:
    walk = np.cumsum(rng.standard_normal(case.rows))
    return Draft(
        [],
        lambda s: Motion(s * np.outer(walk, case.dispersion)),
        lambda s: {"step": (s, "1")},
        1e-7,
        1e-4,
        law="random",
    )


@kind("energy-offset", "optics", planes="x", onset="inside")
def energy_offset(case: Conditions, rng: Rng) -> Draft:
    way = sign(rng)
    return Draft(
        [],
        lambda s: Motion(way * s * np.tile(case.dispersion, (case.rows, 1))),
        lambda s: {"offset": (way * s, "1")},
        3e-6,
        1e-3,
    )


class Skew(Nature):
    """A rolled quadrupole: kicks each plane by the orbit in the other, closed through both."""

    def __init__(self, place: Index, strength: float) -> None:
        self.place, self.strength = place, strength

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.shape = {p: case.kick_orbit(self.place, p)[:, 0] for p in BOTH}
        self.reach = {p: case.orbit_at(self.place, p)[0] for p in BOTH}
        self.ground = {p: case.moved(self.place, p)[:, 0] for p in BOTH}
        own = [float(case.lattice.response(self.place, self.place, p)[0, 0]) for p in BOTH]
        cross = self.strength * np.array([[0, own[0]], [own[1], 0]])
        self.closed = np.linalg.inv(np.eye(2) - cross)

    def bend(self, row: int, orbit: Array, currents: Array) -> Array:
        start = np.array([self.reach[p] @ currents + self.ground[p][row] for p in BOTH])
        x, y = self.closed @ start
        return orbit + self.strength * (self.shape["x"] * y + self.shape["y"] * x)


@kind("skew-coupling", "optics", planes="xy")
def skew_coupling(case: Conditions, rng: Rng) -> Draft:
    quads, way = case.lattice.quads, sign(rng)
    which = int(rng.integers(len(quads)))
    return Draft(
        [case.lattice.ring.names("QUAD")[which]],
        lambda s: Skew(quads[[which]], way * s),
        lambda s: {"skew": (way * s, "1/m")},
        3e-3,
        0.05,
    )
