"""Lines: of the beam, and of what some BPMs read."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import NOISE, make_record

RING = small_ring()
LAYOUT = layout_of(RING, "x", 0.1)
ROWS, CYCLES = 900, 0.0731
KINDS = ("bpm-hum", "periodic-disturbance", "bpm-walk", "local-kick", "noise-level", "energy-drift")


def accepted(orbit: Matrix, seed: int) -> list[Candidate]:
    """Causes of a ring whose magnets move and whose setpoints rest, with an orbit besides."""
    rng = np.random.default_rng(seed)
    magnets = LAYOUT.orbit_per_kick("QUAD", "x")
    moved = (2e-9 * rng.standard_normal((ROWS, magnets.shape[1]))).cumsum(axis=0)
    readings = moved @ magnets.T + orbit
    readings += NOISE * rng.standard_normal(readings.shape)
    setpoints = np.zeros((ROWS, LAYOUT.response.shape[1]))
    record = replace(
        make_record(seed), layout=LAYOUT, readings=readings, setpoints=setpoints,
        requested=setpoints, filled=np.zeros_like(readings, dtype=np.bool_),
    )  # fmt: skip
    kinds = [effect(name) for name in KINDS]
    return tournament(Workspace.of(record, kinds), kinds)[0]


def swinging(amplitude: float) -> Matrix:
    return amplitude * np.cos(2.0 * np.pi * CYCLES * np.arange(ROWS) + 0.4)[:, None]


def test_what_some_bpms_read_swings_and_the_beam_does_not() -> None:
    """Each has its own amplitude; kicks at two dozen places would make nearly such an orbit."""
    struck, sizes = [4, 5, 6, 7], np.array([1.0, -0.7, 0.8, -0.4])
    orbit = np.zeros((ROWS, len(LAYOUT.bpms)))
    orbit[:, struck] = swinging(0.4e-6) * sizes
    (hum,) = accepted(orbit, 3)
    assert hum.kind.id == "bpm-hum"
    assert sorted(hum.places) == struck and hum.places[0] == 4
    assert np.hypot(hum.values["cosine"], hum.values["sine"]) == pytest.approx(0.4e-6, rel=0.1)
    assert hum.values["frequency"] == pytest.approx(CYCLES / 0.1, rel=1e-3)


@pytest.mark.parametrize("places", [[12], [3, 9, 20]])
def test_what_moves_the_beam_is_no_hum(places: list[int]) -> None:
    """From one place, or from several at once."""
    magnets = LAYOUT.orbit_per_kick("QUAD", "x")
    (wave,) = accepted(swinging(30e-9) * magnets[:, places].sum(axis=1), 4)
    assert wave.kind.id == "periodic-disturbance"
