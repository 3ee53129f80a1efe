"""The ground of a healthy ring: girders that heave and tilt, places worse than others."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood import ground
from orbitfb.diagnose.likelihood.ground import ground_shapes
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.estimation.floor import first_noise
from orbitfb.estimation.moments import Moments
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.shapes import Shapes, fit_shapes
from orbitfb.estimation.transform import StepTransform
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import NOISE, kinds_for, recorded, some_devices

LAYOUT = some_devices(4)
"""Every fourth device of the default ring, all 300 quadrupoles between them."""
RING = LAYOUT.known_ring
ORBIT = LAYOUT.orbit_per_kick("QUAD", "x")
ROWS = 1200


def transform_of(rows: int) -> StepTransform:
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    return StepTransform.of(starts, 16)


def read(kicks: Matrix, rng: np.random.Generator, per_kick: Matrix = ORBIT) -> Matrix:
    orbit = kicks.cumsum(axis=0) @ per_kick.T
    return orbit + NOISE * rng.standard_normal(orbit.shape)


def on_girders(rng: np.random.Generator) -> Matrix:
    """Steps of quadrupoles that stand on girders, each of which heaves and tilts as a whole."""
    place = RING.table.s[RING.places("QUAD")]
    girder = np.concatenate([[0], np.cumsum(np.diff(place) > 2.2)])
    heave, tilt = rng.standard_normal((2, ROWS, girder[-1] + 1))
    mean = np.bincount(girder, place) / np.bincount(girder)
    moved = heave[:, girder] + 0.5 * tilt[:, girder] * (place - mean[girder])
    return 4e-9 * moved * RING.strength("QUAD")


def fitted(readings: Matrix, shapes: Shapes) -> tuple[StepNoise, Vector]:
    transform = transform_of(len(readings))
    begin = first_noise(transform.steps(readings), shapes.broad[0])
    moments = Moments.of(transform.spectrum(readings), transform)
    return fit_shapes(begin, moments, shapes, np.zeros_like(begin.walk), rounds=60)


def test_girders_that_heave_and_tilt_are_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another record of the same ground is the likelier for shapes that know of girders."""
    rng = np.random.default_rng(3)
    first, second = read(on_girders(rng), rng), read(on_girders(rng), rng)
    transform = transform_of(ROWS)
    moments = Moments.of(transform.spectrum(second), transform)
    known = moments.log_density(fitted(first, ground_shapes(LAYOUT))[0])
    monkeypatch.setattr(ground, "GIRDERS", ())
    assert known > moments.log_density(fitted(first, ground_shapes(LAYOUT))[0]) + 15.0


def test_a_ring_whose_strengths_nobody_wrote_down_has_ground() -> None:
    table = replace(RING.table, strength=np.full(len(RING.table.s), np.nan))
    shapes = ground_shapes(replace(LAYOUT, ring=replace(RING, table=table)))
    assert 0 < len(shapes.broad) < len(ground_shapes(LAYOUT).broad)
    assert all(np.isfinite(one).all() for one in shapes.broad)


def test_a_girder_may_stand_where_the_ring_begins() -> None:
    place = np.array([1.0, 2.0, 9.0, 10.0, 19.5])
    girder, arm = ground._girders(place, 20.0, 2.0)
    assert list(girder) == [0, 0, 1, 1, 0]
    assert arm == pytest.approx([1.0 / 6.0, 7.0 / 6.0, -0.5, 0.5, -4.0 / 3.0])


def test_an_energy_that_wanders_is_no_ground() -> None:
    """A ring whose ground breathes would do the same, and that is the effect."""
    rng = np.random.default_rng(8)
    readings = read(1e-9 * rng.standard_normal((ROWS, ORBIT.shape[1])) * RING.strength("QUAD"), rng)
    energy = 3e-8 * rng.standard_normal(ROWS).cumsum()
    readings += np.outer(energy, LAYOUT.dispersion())
    record = recorded(LAYOUT, np.zeros((ROWS, LAYOUT.response.shape[1])), readings)
    kinds = kinds_for(record)
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["energy-drift"]
    assert accepted[0].values["step"] == pytest.approx(3e-8, rel=0.2)


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_a_ground_that_moves_more_from_a_row_on_is_told(factor: float) -> None:
    rng = np.random.default_rng(9)
    moved = 3e-9 * rng.standard_normal((ROWS, ORBIT.shape[1])) * RING.strength("QUAD")
    moved[ROWS // 2 :] *= factor
    record = recorded(LAYOUT, np.zeros((ROWS, LAYOUT.response.shape[1])), read(moved, rng))
    kinds = kinds_for(record)
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["ground-motion-level"] * (factor > 1.0)
    for one in accepted:
        assert one.values["factor"] == pytest.approx(factor, rel=0.25)
        assert one.onset == pytest.approx(ROWS // 2, abs=ROWS // 20)


def test_a_place_that_walks_as_all_others_do_has_no_walk_of_its_own() -> None:
    """Without a prior chance gives a tenth of the walk to single places."""
    rng = np.random.default_rng(4)
    readings = read(4e-9 * rng.standard_normal((ROWS, ORBIT.shape[1])), rng)
    shapes = ground_shapes(LAYOUT)

    def alone(shapes: Shapes) -> float:
        share = fitted(readings, shapes)[1] * shapes.seen(np.eye(len(ORBIT)))
        return float(np.sum(share[len(shapes.broad) :]) / np.sum(share))

    assert alone(shapes) < 0.1
    assert alone(replace(shapes, bodies=0)) > 2.0 * alone(shapes)


@pytest.mark.parametrize("uneven", ["all", "one"])
def test_a_healthy_ring_on_uneven_ground_gets_no_name(uneven: str) -> None:
    """Quadrupoles walk by what differs by 20 times, or one walks six times as much as the rest."""
    rng, layout = np.random.default_rng(2), layout_of(small_ring(), "x", 0.1)
    per_kick = layout.orbit_per_kick("QUAD", "x")
    level = np.ones(per_kick.shape[1])
    if uneven == "all":
        level = np.exp(rng.standard_normal(len(level)))
    else:
        level[17] = 6.0
    setpoints = (0.003 * rng.standard_normal((ROWS, layout.response.shape[1]))).cumsum(axis=0)
    moved = read(4e-9 * level * rng.standard_normal((ROWS, len(level))), rng, per_kick)
    record = recorded(layout, setpoints, setpoints @ layout.response.T + moved)
    kinds = kinds_for(record)
    assert not tournament(Workspace.of(record, kinds), kinds)[0]
