"""Rows and columns of the response that are wrong element by element."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.elements import scan_elements
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.named import named
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.laws import DeviceLaw, ElementsLaw
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import kinds_for, make_record


def wrong(record: Record, change: Matrix) -> Record:
    """The same readings with a model that lacks a change of the response."""
    layout = replace(record.layout, response=record.layout.response - change)
    return replace(record, layout=layout)


def changed(record: Record, seed: int, row: int | None, column: int | None) -> Matrix:
    """Errors of a fifth of the response in a row or a column, shape (n, m) [m/A]."""
    response = record.layout.response
    change = np.zeros_like(response)
    errors = 0.2 * np.std(response) * np.random.default_rng(seed).standard_normal(response.shape)
    if row is not None:
        change[row] = errors[row]
    if column is not None:
        change[:, column] = errors[:, column]
    return change


@pytest.mark.parametrize(
    ("row", "column", "kind", "name"),
    [
        (5, None, "bpm-row", "B5 (x)"),
        pytest.param(None, 7, "corrector-column", "C7 (x)", marks=pytest.mark.nightly),
    ],
)
def test_a_row_or_a_column_is_named_with_its_elements(
    row: int | None, column: int | None, kind: str, name: str
) -> None:
    record = make_record(31, dither=0.1)
    change = changed(record, 1, row, column)
    told = wrong(record, change)
    accepted, rounds = tournament(Workspace.of(told, kinds_for(told)), kinds_for(told))
    assert [(one.kind.id, one.names) for one in accepted] == [(kind, (name,))]
    its = Explained.of(named(accepted, rounds), accepted, rounds)
    ((piece,),) = its.pieces[0]
    true = change[row] if row is not None else change[:, column]
    found = np.array(list(piece.elements.values()))
    assert np.linalg.norm(found - true) < 0.1 * np.linalg.norm(true)
    model = told.layout.response[row] if row is not None else told.layout.response[:, column]
    share = np.linalg.norm(found) / np.linalg.norm(model)
    assert piece.values["share"] == pytest.approx(share)
    assert its.fields[0] is not None


def test_the_evidence_is_that_of_free_elements_written_out() -> None:
    """½ aᵀ(1/v + H)⁻¹a − ½ ln |1 + vH| with a and H summed over all elements and frequencies."""
    record = make_record(32)
    told = wrong(record, changed(record, 2, 3, None))
    space = Workspace.of(told, [effect("bpm-row")])  # no healthy errors beside
    scorer = Scorer.of(space)
    (law,) = effect("bpm-row").laws(space.signals)
    assert isinstance(law, ElementsLaw)
    found = scan_elements(effect("bpm-row"), law, scorer)[0]
    assert found.names == ("B3 (x)",)
    spectrum = space.transform.spectrum(space.signals.currents)
    weight = space.noise.inverse_variance(space.transform)[space.transform.band]
    own = weight @ (space.noise.modes[3] ** 2)
    information = (spectrum * own[:, None]).T @ spectrum
    pull = spectrum.T @ scorer.pulled[:, 3]
    evidence = []
    for width in (0.01, 0.03, 0.1, 0.3, 1.0):
        variance = (width * law.scale[3]) ** 2
        inner = np.eye(len(pull)) + variance * information
        square = variance * pull @ np.linalg.solve(inner, pull)
        evidence.append(0.5 * square - 0.5 * np.linalg.slogdet(inner)[1])
    assert found.evidence == pytest.approx(max(evidence) - np.log(16) - 3.0, rel=1e-3)


@pytest.mark.parametrize(("row", "column"), [(5, None), (None, 7)])
def test_over_another_floor_they_are_told_beside_its_own_errors(
    row: int | None, column: int | None
) -> None:
    """As where they were found over that floor, whatever they were found over."""
    record = make_record(31, dither=0.1)
    told = wrong(record, changed(record, 1, row, column))
    kind, kinds = effect("bpm-row" if column is None else "corrector-column"), kinds_for(told)
    space = Workspace.of(told, kinds)
    (gains,) = effect("bpm-gain").laws(space.signals)
    assert isinstance(gains, DeviceLaw)
    one = gains.patterns[0][:, :1], np.zeros(1, dtype=np.intp), space.signals.orbit[:, :1]
    more = space.beside(effect("bpm-gain"), gains, *one, ((0, "gain"),), 0.1)
    more = more.with_noise(replace(more.noise, white=2.0 * more.noise.white))
    (law,) = kind.laws(space.signals)
    assert isinstance(law, ElementsLaw)
    again = []
    for begin in (space, more):
        found = scan_elements(kind, law, Scorer.of(begin))[0]
        assert found.again is not None
        assert found.field is not None
        again.append(found.again(more.explaining(found.field)))
    assert again[0].names == again[1].names
    assert again[0].evidence == pytest.approx(again[1].evidence, rel=1e-4)


def test_a_healthy_response_has_no_such_device() -> None:
    record = make_record(33)
    space = Workspace.of(record, kinds_for(record))
    best: list[Candidate] = []
    for name in ("bpm-row", "corrector-column"):
        (law,) = effect(name).laws(space.signals)
        assert isinstance(law, ElementsLaw)
        best += scan_elements(effect(name), law, Scorer.of(space))
    assert all(one.evidence < 5.0 for one in best)


@pytest.mark.parametrize(
    ("size", "by_one_factor", "told"),
    [(0.2, False, True), (0.2, True, False), (0.025, False, False)],
    ids=["odd", "by one factor", "as in a healthy ring"],
)
def test_a_row_is_told_if_it_is_more_wrong_than_a_healthy_one_and_in_no_order(
    size: float, by_one_factor: bool, told: bool
) -> None:
    record = make_record(36, dither=0.5)
    change = np.zeros_like(record.layout.response)
    row = record.layout.response[5]
    odd = np.std(row) * np.random.default_rng(2).standard_normal(len(row))
    change[5] = size * (row if by_one_factor else odd)
    kind = effect("bpm-row")
    space = Workspace.of(wrong(record, change), kinds_for(record))
    (law,) = space.courses.laws(kind)
    assert isinstance(law, ElementsLaw)
    assert bool(scan_elements(kind, law, Scorer.of(space))) == told
