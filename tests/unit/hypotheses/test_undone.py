"""Readings that are undone: exchanged, of the other sign, bent."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.echoes import is_echo
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import NOISE, Bent, kinds_for, make_record, recorded

ROWS = 300


def exchanged(orbit: Matrix) -> Matrix:
    read = orbit.copy()
    read[:, [2, 7]] = orbit[:, [7, 2]]
    return read


def reversed_sign(orbit: Matrix) -> Matrix:
    read = orbit.copy()
    read[:, 7] *= -1.0
    return read


@pytest.mark.parametrize(
    ("sensed", "kind", "places", "onset"),
    [
        (exchanged, "bpm-swap", (2, 7), 0),
        (exchanged, "bpm-swap", (2, 7), 131),
        (reversed_sign, "bpm-polarity", (7,), 0),
        (reversed_sign, "bpm-polarity", (7,), 131),
    ],
)
def test_one_cause_is_told_from_its_row_on(
    sensed: Bent, kind: str, places: tuple[int, ...], onset: int
) -> None:
    """The floor of all knows what they do for noise of these BPMs, and needs turns to leave it."""
    rows = iter(range(ROWS))

    def late(orbit: Matrix) -> Matrix:
        return sensed(orbit) if next(rows) >= onset else orbit

    record = make_record(0, sensed=late, gain=0.05, rows=ROWS)
    kinds = kinds_for(record)

    accepted, _ = tournament(Workspace.of(record, kinds), kinds)

    assert [(one.kind.id, one.places, one.onset) for one in accepted] == [(kind, places, onset)]


def test_the_size_of_a_curve_is_that_which_undoes_it() -> None:
    """The orbit that is read is bent already: told along it, a quarter would be two fifths."""
    rng, layout = np.random.default_rng(7), make_record(11).layout
    setpoints = 0.3 * rng.standard_normal((ROWS, layout.response.shape[1]))
    kicks = (1e-3 * rng.standard_normal(setpoints.shape)).cumsum(axis=0)
    orbit = 60e-6 + (setpoints + kicks) @ layout.response.T
    bent = orbit.copy()
    bent[:, 7] -= 4000.0 * orbit[:, 7] ** 2
    record = recorded(layout, setpoints, bent + NOISE * rng.standard_normal(orbit.shape))
    kinds = kinds_for(record)

    accepted, _ = tournament(Workspace.of(record, kinds), kinds)

    assert [(one.kind.id, one.places) for one in accepted] == [("bpm-nonlinearity", (7,))]
    assert accepted[0].values["quadratic"] == pytest.approx(-4000.0, rel=0.03)


def test_a_curve_is_heard_from_where_the_orbit_stood() -> None:
    """A BPM that is bent by 3.6 µm in the first row makes no other orbit of that."""
    rng, layout = np.random.default_rng(7), make_record(11).layout
    setpoints = 0.3 * rng.standard_normal((ROWS, layout.response.shape[1]))
    orbit = 60e-6 + setpoints @ layout.response.T
    bent = orbit.copy()
    bent[:, 7] -= 1000.0 * orbit[:, 7] ** 2
    record = recorded(layout, setpoints, bent + NOISE * rng.standard_normal(orbit.shape))
    kind = effect("bpm-nonlinearity")
    space = Workspace.of(record, [kind])
    best = next(one for one in candidates_of(space, [kind]) if one.places == (7,))
    heard = replace(best, noise_after=True).accepted(space).signals.orbit[:, 7]
    assert abs(np.mean(heard - orbit[:, 7])) < 1e-6


def test_readings_are_undone_once() -> None:
    """They are undone as they were read: what a law took off before would be there again."""
    polarity = Candidate(
        effect("bpm-polarity"), (7,), ("B7 (x)",), {}, 900.0,
        undone=lambda space: (np.zeros_like(space.residual), 0.0),
    )  # fmt: skip
    curve = Candidate(effect("bpm-nonlinearity"), (7,), ("B7 (x)",), {"quadratic": 1.0}, 2000.0)
    assert is_echo(polarity, [curve])
    assert not is_echo(polarity, [replace(curve, places=(6,))])


def test_a_curve_is_told_in_both_of_its_sizes() -> None:
    """It bends to one side, and saturates: neither alone is nearly as likely.

    A gain error of 1 % that a healthy BPM may have is 3 % of its quadratic size.
    """
    rng, layout = np.random.default_rng(7), make_record(11).layout
    setpoints = 0.3 * rng.standard_normal((ROWS, layout.response.shape[1]))
    kicks = (1e-3 * rng.standard_normal(setpoints.shape)).cumsum(axis=0)
    orbit = 60e-6 + (setpoints + kicks) @ layout.response.T
    bent = orbit + NOISE * rng.standard_normal(orbit.shape)
    bent[:, 7] += 3000.0 * bent[:, 7] ** 2 - 2e7 * bent[:, 7] ** 3
    record = recorded(layout, setpoints, bent)
    kinds = kinds_for(record)

    found = candidates_of(Workspace.of(record, kinds), [effect("bpm-nonlinearity")])

    best = next(one for one in found if one.kind.id == "bpm-nonlinearity" and one.places == (7,))
    assert best.values["quadratic"] == pytest.approx(3000.0, rel=0.03)
    assert best.values["cubic"] == pytest.approx(-2e7, rel=0.03)
