"""The screen: every kind of row that would poison an estimate is left out and counted."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.transitions import Transitions
from orbitfb.models.rows import select_rows


def clean(count=8, n=12, m=3):
    applied = np.arange(count * m, dtype=float).reshape(count, m) * 1e-3
    setpoints = np.vstack([np.zeros(m), np.cumsum(applied, axis=0)])
    orbit = np.random.default_rng(0).standard_normal((count + 1, n)) * 1e-6
    time = np.arange(count + 1, dtype=float)
    return Transitions(
        tick=np.arange(count),
        time=time[:-1],
        next_time=time[1:],
        written=time[:-1],
        orbit=orbit[:-1].copy(),
        next_orbit=orbit[1:].copy(),
        reference=np.zeros((count, n)),
        valid=np.ones((count, n), dtype=bool),
        requested=applied.copy(),
        applied=applied,
        dither=np.zeros((count, m)),
        setpoints=setpoints[:-1].copy(),
        readback=setpoints[:-1].copy(),
        policy_id=np.full(count, "p"),
        closed=np.ones(count, dtype=bool),
        hertz=np.zeros(count),
        usable=np.ones(count, dtype=bool),
        auxiliary={},
    )


def spoil_usable(t):
    t.usable[3] = False


def spoil_change(t):
    t.applied[3, 1] = np.nan


def spoil_orbit(t):
    t.next_orbit[3, 1] = np.inf


def spoil_bpms(t):
    t.valid[3, :4] = False


def spoil_readback(t):
    t.readback[3, 0] += 1.0


def spoil_bump(t):
    t.setpoints[4:] += 1.0
    t.readback[4:] += 1.0


def spoil_reference(t):
    t.reference[4:] += 1e-6


@pytest.mark.parametrize(
    ("reason", "spoil"),
    [
        ("unusable", spoil_usable),
        ("not_finite", spoil_change),
        ("not_finite", spoil_orbit),
        ("invalid_bpms", spoil_bpms),
        ("readback", spoil_readback),
        ("foreign_change", spoil_bump),
        ("reference", spoil_reference),
    ],
)
def test_left_out_and_counted(reason, spoil):
    transitions = clean()
    spoil(transitions)
    rows = select_rows(transitions, 0.01)
    assert 3 not in rows.tick
    assert rows.left_out.get(reason) == 1
    assert rows.starts[list(rows.tick).index(4)]
    assert np.isfinite(rows.change).all() and np.isfinite(rows.difference).all()


def test_clean_rows_stay():
    rows = select_rows(clean(), 0.01)
    assert len(rows) == 8
    assert rows.left_out == {}
    assert list(rows.starts) == [True] + [False] * 7


def test_one_invalid_bpm_of_many_stays_with_a_difference_of_zero():
    transitions = clean()
    transitions.valid[3, 0] = False
    transitions.orbit[3, 0] = np.nan
    rows = select_rows(transitions, 0.01)
    assert len(rows) == 8
    assert rows.difference[3, 0] == 0.0 and not rows.valid[3, 0]


def test_a_gap_in_the_ticks_starts_anew_and_is_no_foreign_change():
    transitions = clean()
    gap = replace(transitions, tick=transitions.tick + 5 * (np.arange(8) >= 4))
    gap.setpoints[4:] += 1.0
    gap.readback[4:] += 1.0
    rows = select_rows(gap, 0.01)
    assert len(rows) == 8
    assert rows.starts[4]
