"""How the circumstances of a case are drawn."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions, Dither, GroundLaw
from benchmarks.blind.generator.rings import Array, Lattice, beating_errors
from orbitfb.physics.places import Plane, Planes, Ring, split

GROUND = ("quadrupoles", "girders", "memory", "going on")
"""How quadrupoles move: alone, with their girder, coming back, on in the direction of before."""


def draw(
    rng: np.random.Generator,
    ring: Ring,
    ring_id: str,
    planes: Planes,
    ticks: int,
    dither: Dither,
    background: bool = True,
) -> Conditions:
    """Draw the circumstances of a case."""
    warm = 100
    lattice = Lattice(ring, np.zeros(len(ring.places("QUAD"))))
    if background:
        lattice.errors = beating_errors(ring, rng.uniform(0.01, 0.02), rng)
    bpms, correctors = len(ring.names("BPM")), len(ring.names("COR"))
    n, m = bpms * len(split(planes)), correctors * len(split(planes))
    noise = rng.uniform(0.1e-6, 0.4e-6)
    stated = noise * rng.uniform(0.95, 1.05) if rng.random() < 0.5 else np.nan
    spread = np.exp(0.02 * rng.standard_normal(n)) if rng.random() < 0.5 else np.ones(n)
    kind = GROUND[rng.integers(len(GROUND))]
    case = Conditions(
        lattice=lattice,
        ring_id=ring_id,
        planes=planes,
        ticks=ticks,
        warm=warm,
        period=float(rng.choice([0.1, 0.1, 0.05, 0.2])),
        delay=rng.uniform(0.01, 0.08),
        gain=rng.uniform(0.2, 0.6),
        regularisation=np.exp(rng.uniform(np.log(0.005), np.log(0.05))),
        noise=noise * spread,
        stated_noise=stated,
        bpm_gains=0.01 * background * rng.standard_normal(n),
        corrector_gains=0.01 * background * rng.standard_normal(m),
        dither_kind=dither,
        dither=np.zeros((warm + ticks + 1, m)),
        reference=np.zeros((warm + ticks + 1, n)),
        quad_kicks={},
        ground=kind,
        ground_laws={},
        ground_step=np.exp(rng.uniform(np.log(0.01e-6), np.log(0.08e-6))),
        current=np.zeros(warm + ticks + 1),
        gap=np.zeros(warm + ticks + 1),
    )
    case.reference = _golden_orbits(case, rng)
    case.dither = _excursions(case, rng)
    standing = np.exp(rng.uniform(np.log(30e-6), np.log(250e-6)))
    for plane in case.all_planes:
        case.quad_kicks[plane], case.ground_laws[plane] = wander(case, plane, standing, rng)
    case.current = _top_up(case, rng)
    case.gap = _gap(case, rng)
    return case


def _golden_orbits(case: Conditions, rng: np.random.Generator) -> Array:
    """Steps of the golden orbit: bumps that a few correctors make."""
    start = rng.uniform(5e-6, 60e-6)
    count = int(rng.integers(4, 9))
    times = np.sort(rng.choice(np.arange(case.warm + 40, case.rows - 40), count, replace=False))
    shape = case.model @ _few(case, rng, 12)
    orbit = np.tile(shape * start / np.sqrt(np.mean(shape**2)), (case.rows, 1))
    size = np.exp(rng.uniform(np.log(2e-6), np.log(15e-6)))
    for tick in times:
        step = case.model @ _few(case, rng, int(rng.integers(3, 10)))
        orbit[tick:] += step * size / np.sqrt(np.mean(step**2))
    return orbit


def _few(case: Conditions, rng: np.random.Generator, count: int) -> Array:
    kicks = np.zeros(len(case.corr_names))
    chosen = rng.choice(len(kicks), count, replace=False)
    kicks[chosen] = rng.standard_normal(count)
    return kicks


def _excursions(case: Conditions, rng: np.random.Generator) -> Array:
    shape = (case.rows, len(case.corr_names))
    if case.dither_kind == "passive":
        return np.zeros(shape)
    per_ampere = np.mean(np.abs([case.lattice.ring.calibration(p) for p in case.all_planes]))
    white = rng.standard_normal(shape)
    if case.dither_kind == "white":
        return white * rng.uniform(6e-9, 15e-9) / per_ampere
    # Every singular mode moves the orbit about equally; the weak ones are held back.
    _, size, right = np.linalg.svd(case.model, full_matrices=False)
    weight = 1 / np.maximum(size, 0.02 * size[0])
    coloured = (white[:, : len(size)] * weight) @ right
    return (
        coloured * rng.uniform(0.15e-6, 0.4e-6) / np.sqrt(np.mean((coloured @ case.model.T) ** 2))
    )


def wander(
    case: Conditions, plane: Plane, standing: float, rng: np.random.Generator
) -> tuple[Array, GroundLaw]:
    """Kicks of quadrupoles that stand beside their axes and wander, and by what law."""
    lattice, rows = case.lattice, case.rows
    quads = lattice.quads
    strength = lattice.ring.strength("QUAD") * (1 if plane == "x" else -1)
    steps = rng.standard_normal((rows, len(quads)))
    if case.ground == "girders":
        # Neighbours within 8 m stand on one girder: it heaves and tilts as a whole.
        s = lattice.ring.table.s[quads]
        girder = np.concatenate([[0], np.cumsum(np.diff(s) > rng.uniform(1.5, 3.0))])
        heave, tilt = rng.standard_normal((2, rows, girder[-1] + 1))
        arm = s - np.array([s[girder == g].mean() for g in girder])
        steps = 0.2 * steps + heave[:, girder] + 0.3 * tilt[:, girder] * arm
    on = rng.uniform(0.2, 0.5)
    law = GroundLaw()
    if case.ground == "going on":
        law = GroundLaw(on=on)
        for row in range(1, rows):
            steps[row] = on * steps[row - 1] + np.sqrt(1 - on**2) * steps[row]
    steps[0] = 0
    at_bpms = lattice.response(case.bpms, quads, plane) * strength
    steps *= case.ground_step / np.sqrt(np.mean((steps[: min(rows, 400)] @ at_bpms.T) ** 2))
    keep = np.exp(-1 / np.exp(rng.uniform(np.log(300), np.log(10_000))))
    if case.ground == "memory":
        law = GroundLaw(keep)
        moves = np.empty_like(steps)
        here = np.zeros(len(quads))
        for row in range(rows):
            here = keep * here + steps[row]
            moves[row] = here
    else:
        moves = np.cumsum(steps, axis=0)
    still = rng.standard_normal(len(quads))
    still *= standing / np.sqrt(np.mean((at_bpms @ still) ** 2))
    return (moves + still) * strength, law


def _top_up(case: Conditions, rng: np.random.Generator) -> Array:
    """Beam that decays and is filled up now and then; read with a little noise."""
    time = np.arange(case.rows) * case.period
    every = rng.uniform(0.15, 0.4) * time[-1]
    phase = (time / every + rng.random()) % 1.0
    full = rng.uniform(0.2, 0.5)
    return full * (1 - rng.uniform(0.005, 0.03) * phase) + 2e-6 * rng.standard_normal(case.rows)


def _gap(case: Conditions, rng: np.random.Generator) -> Array:
    """A gap that closes, opens half-way and opens, at a finite speed."""
    knots = np.sort(rng.uniform(0.05, 0.95, 6)) * case.rows
    least, most = rng.uniform(6e-3, 12e-3), rng.uniform(25e-3, 40e-3)
    half = least + 0.4 * (most - least)
    values = [most, least, least, half, half, most]
    return np.interp(np.arange(case.rows), knots, values)
