"""Rows that are struck, alone and one after the other."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses import events
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise.tails import Tails
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.settled import settled
from orbitfb.estimation.priors import KNOWN_TO
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import (
    BPMS,
    CORRECTORS,
    NOISE,
    ROWS,
    early,
    kinds_for,
    make_record,
    recorded,
    remembered,
)

SHARE = 0.15


def losing(seed: int) -> Record:
    """A loop whose setpoints are lost now and then, all of them at once."""
    rng = np.random.default_rng(seed)

    def step(state: Vector, row: Vector) -> Vector:
        return state if rng.random() < SHARE else row

    return make_record(11, remembered(step))


def losing_runs(seed: int, held: list[Vector]) -> Record:
    """A loop whose setpoints are lost now and then, each time four sets of them in a row.

    Args:
        seed: Of the record.
        held: Becomes what the correctors have, row by row.
    """
    rng = np.random.default_rng(seed)
    left = [0]

    def step(state: Vector, row: Vector) -> Vector:
        if not left[0] and rng.random() < 0.02:
            left[0] = 4
        now = state if left[0] else row
        left[0] = max(left[0] - 1, 0)
        held.append(now)
        return now

    return make_record(12, remembered(step))


def losing_a_cell(seed: int) -> Record:
    """Setpoints of noise, of which three correctors miss some: each change is undone by the next.

    The ground walks as much from row to row as the readings are noisy.
    """
    rng, base = np.random.default_rng(seed), make_record(11).layout
    cells = tuple(f"C{number // 3}" for number in range(CORRECTORS))
    layout = replace(base, correctors=replace(base.correctors, cells=cells))
    setpoints = 0.02 * rng.standard_normal((ROWS, CORRECTORS))
    acting = setpoints.copy()
    for row in range(1, ROWS):
        if rng.random() < 0.08:
            acting[row, 3:6] = acting[row - 1, 3:6]
    kicks = (1e-3 * rng.standard_normal((ROWS, CORRECTORS))).cumsum(axis=0)
    noise = 0.1 * NOISE * rng.standard_normal((ROWS, BPMS))
    return recorded(layout, setpoints, (acting + kicks) @ layout.response.T + noise)


def best(record: Record) -> Candidate:
    kinds = [kind for kind in kinds_for(record) if kind.id == "missed-write"]
    return candidates_of(Workspace.of(record, kinds_for(record)), kinds)[0]


def test_writes_that_are_missed_in_a_row_are_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in seven that are missed follows another one: the plant then holds an older set."""
    record = losing(5)

    whole = best(record)
    monkeypatch.setattr(events, "STRUCK_RUN", 1)
    single = best(record)

    assert whole.values["probability"] == pytest.approx(SHARE, rel=0.25)
    assert whole.evidence > single.evidence + 100.0


def test_rows_that_are_missed_one_after_the_other_are_all_found() -> None:
    """Strikes in neighbouring rows share information: each for itself says less than both."""
    held: list[Vector] = []
    record = losing_runs(7, held)
    truth = (np.array(held) - record.setpoints) @ record.layout.response.T
    space = Workspace.of(record, kinds_for(record))

    one, _ = settled(best(record), space, spread=False)

    assert one.field is not None
    left = space.transform.spectrum(truth) - one.field
    assert np.sum(left**2) < 0.05 * np.sum(space.transform.spectrum(truth) ** 2)


def test_strikes_that_are_found_are_no_chance() -> None:
    """What noise gives of the other sign is told beside them: a row undoes the one before."""
    record = losing_a_cell(6)

    one, _ = settled(best(record), Workspace.of(record, kinds_for(record)), spread=False)

    share = one.values["probability"]
    choice = -ROWS * (share * np.log(share) + (1.0 - share) * np.log1p(-share))
    assert one.names == ("C1",)
    assert one.cost is not None
    assert one.cost < 1.2 * choice


def test_what_is_early_by_chance_is_early_on_average() -> None:
    """A delay beside the jitter would be the mean of the same samples."""
    share, period = 0.15, 0.1
    record = early(8, share)
    kinds = kinds_for(record)
    space = Workspace.of(record, kinds)
    (one,) = candidates_of(space, [kind for kind in kinds if kind.id == "clock-jitter"])[:1]

    told, after = settled(one, space, spread=False)

    assert told.values["rms"] == pytest.approx(share * period / np.sqrt(2.0), rel=0.1)
    mean = -share * period / np.sqrt(2.0 * np.pi)
    assert told.values["mean"] == pytest.approx(mean, abs=3.0 * told.deviations["mean"] * -mean)
    assert told.deviations["mean"] < 0.2
    late = [kind for kind in kinds if kind.id in ("loop-delay", "corrector-lag")]
    assert not [one for one in candidates_of(after, late) if one.evidence > 0.0]


def test_what_is_always_late_is_no_jitter() -> None:
    """A mean beyond what samples that are only early can have is a delay."""
    before: list[Vector] = [np.zeros(CORRECTORS)]

    def step(state: Vector, row: Vector) -> Vector:
        before.append(row)
        return row - 0.15 * (row - before[-2])

    record = make_record(11, remembered(step))
    kinds = kinds_for(record)
    space = Workspace.of(record, kinds)
    some = [kind for kind in kinds if kind.id in ("clock-jitter", "loop-delay")]
    found = {one.kind.id: one for one in reversed(candidates_of(space, some))}
    assert found["clock-jitter"].values["mean"] == 0.0
    assert found["loop-delay"].evidence > 1.5 * found["clock-jitter"].evidence


def test_tails_that_do_not_show_are_known_no_better_than_before() -> None:
    """Of readings without strikes the likelihood is flat, and bends either way."""
    rng = np.random.default_rng(3)
    tails = Tails(rng.standard_normal((200, 1)), np.array([1e-7]))
    for share, amplitude in ((1e-3, 1e-8), (1e-4, 1e-6), (0.4, 1e-8)):
        assert np.all(tails.spread(share, amplitude) <= KNOWN_TO * (1.0 + 1e-9))
        assert np.all(tails.spread(share, amplitude) > 0.0)
