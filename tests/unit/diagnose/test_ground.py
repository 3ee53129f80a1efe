"""How quadrupoles move together is read off the record, and is no cause."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.noise_modes import GROUNDS, NoiseModes, _moves
from orbitfb.diagnose.noise_walk import walking_candidates
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
QUIET = simulate_record(RING, "x", 1500, 5, [])
STRENGTH = RING.strength("QUAD")


def record_on(ground, size=3e-8, seed=3):
    """A beam on quadrupoles that step by so much from tick to tick, together as told."""
    rng = np.random.default_rng(seed)
    place = RING.table.s[RING.places("QUAD")]
    if ground == "alone":
        steps = size * rng.standard_normal((len(QUIET), len(place)))
    else:  # each stretch of ground grows by a step of its own, and all of them close
        grown = np.sqrt(np.diff(place, prepend=0.0)) * rng.standard_normal((len(QUIET), len(place)))
        rest = np.sqrt(RING.parameters.circumference - place[-1]) * rng.standard_normal(len(QUIET))
        moved = np.cumsum(grown, axis=1)
        end = (moved[:, -1] + rest)[:, None] / RING.parameters.circumference
        steps = size * (moved - end * place)
    orbit = QUIET.layout.orbit_per_kick("QUAD", "x") * STRENGTH
    moved = np.cumsum(steps, axis=0) @ orbit.T
    return replace(QUIET, readings=QUIET.readings + moved)


@pytest.mark.parametrize("ground", ["alone", "diffusion"])
def test_a_record_tells_how_the_ground_moves(ground):
    bench = Bench(record_on(ground))
    assert bench.floor.modes.ground == ground


def test_ground_that_diffuses_is_no_wandering_energy_or_crate():
    record = record_on("diffusion")
    for name in ("energy-drift", "bpm-walk"):
        found = walking_candidates(Bench(record), all_effects()[name])
        assert all(one.gain - np.log(one.choices) < 5.0 for one in found), name


def test_an_energy_that_wanders_is_none_of_the_ground():
    wander = np.cumsum(3e-7 * np.random.default_rng(4).standard_normal(len(QUIET)))
    record = record_on("alone")
    shaken = replace(record, readings=record.readings + np.outer(wander, QUIET.layout.dispersion()))
    bench = Bench(shaken)
    assert bench.floor.modes.ground == "alone"
    assert walking_candidates(bench, all_effects()["energy-drift"])[0].gain > 30.0


@pytest.mark.parametrize("ground", GROUNDS)
def test_the_motion_of_any_ground_has_a_covariance(ground):
    together = _moves(RING, ground)
    np.testing.assert_array_equal(together, together.T)
    sizes = np.linalg.eigvalsh(together)
    assert sizes[0] > -1e-9 * sizes[-1]
    assert NoiseModes.of(QUIET.layout, ground=ground).ground == ground


def test_bpms_keep_their_noise_when_the_ground_is_found():
    record = record_on("diffusion")
    loud = np.where(np.arange(len(record.layout.bpms)) % 2, 2.0, 0.5)
    noise = 3e-7 * np.random.default_rng(6).standard_normal(record.readings.shape)
    modes = Bench(replace(record, readings=record.readings + loud * noise)).floor.modes
    assert modes.ground == "diffusion"
    assert np.corrcoef(modes.spread, loud)[0, 1] > 0.9


def test_what_a_corrector_does_is_not_left_to_the_ground():
    layout = layout_of(RING, "x", 0.1)
    slow = layout.correctors.names[40]
    effects = build([parse_effect(f"corrector-lag:tau=0.05s,names={slow}")], layout, 1)
    record = simulate_record(
        RING, "x", 900, 5, effects, period=layout.period, steering=1, steering_rms=100e-6,
        regularisation=10e-6,
    )  # fmt: skip
    assert Bench(record).floor.modes.ground != "alone"  # it passes for some of it at first sight
    kinds = [all_effects()[name] for name in ("corrector-lag", "energy-drift", "bpm-walk")]
    found = search(record, kinds)
    assert found.bench.floor.modes.ground == "alone"
    (one,) = found.winners
    assert one.accepted.kind.id == "corrector-lag"
    assert one.accepted.cause.places == (40,)


def test_a_ring_without_a_table_has_the_modes_of_its_response():
    strange = replace(QUIET.layout, ring=None)
    modes = Bench(replace(record_on("diffusion"), layout=strange)).floor.modes
    assert modes.ground == "alone"
