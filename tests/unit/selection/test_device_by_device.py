"""What devices that remember held when the record began, and their own widths, are found."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.estimation.priors import SURE
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import CORRECTORS, Bent, kinds_for, make_record, remembered

HALF = 0.01
"""Half of the play [A]."""

BEGAN = np.linspace(-1.0, 1.0, CORRECTORS)
"""Where in it the correctors began, a part of the half."""


def dragged(half: Vector | float, first: Vector) -> Bent:
    """Play, from the definition; each corrector began at some part of its half width."""
    return remembered(lambda held, row: np.clip(held, row - half, row + half), first=half * first)


def test_a_play_has_its_width_wherever_its_correctors_began() -> None:
    found = diagnose(
        make_record(31, currents=dragged(HALF, BEGAN), dither=0.002, rows=500),
        seed=0,
        progress=lambda what, share: None,
    )
    assert [one.effect for one in found.causes] == ["corrector-hysteresis"]
    told = found.causes[0].parameters
    assert abs(told["width"].value - 2.0 * HALF) < 0.1 * 2.0 * HALF
    assert abs(told["share"].value - 1.0) < 0.05


def test_every_corrector_has_a_play_of_its_own() -> None:
    """Three times as wide at one end of the ring as at the other: no one width is near."""
    half = HALF * np.linspace(0.5, 1.5, CORRECTORS)
    found = diagnose(
        make_record(32, currents=dragged(half, BEGAN), dither=0.002, rows=500),
        seed=0,
        progress=lambda what, share: None,
    )
    assert [one.effect for one in found.causes] == ["corrector-hysteresis"]
    widths = {one.places: one.values["width"] for one in found.causes[0].by_place}
    told = np.array([widths[f"C{number}",] for number in range(CORRECTORS)])
    assert np.all(np.abs(told / (2.0 * half) - 1.0) < 0.15)
    assert np.sqrt(np.mean((told / (2.0 * half) - 1.0) ** 2)) < 0.06


def test_what_a_law_leaves_at_its_devices_is_told_by_that_law() -> None:
    """Two plays in a row are no law of the library: one, and what it leaves, are."""
    narrow, wide = (dragged(width, np.zeros(CORRECTORS)) for width in (0.03, 0.09))

    def both(currents: Matrix) -> Matrix:
        return 0.5 * currents[-1:] + 0.35 * narrow(currents) + 0.15 * wide(currents)

    record = make_record(33, currents=both, dither=0.05)
    kinds = kinds_for(record)

    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)

    assert {one.kind.id for one in accepted} == {"corrector-hysteresis"}
    left = [one for one in rounds[-1].candidates if one.kind.id == "corrector-hysteresis"]
    assert max((one.evidence for one in left), default=0.0) < SURE
