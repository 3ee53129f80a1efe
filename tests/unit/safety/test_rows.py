"""Rows of correctors that do not follow never teach."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.rows import astray

S = InterlockSettings(readback_lag=1, readback_ticks=2)


class Rows(SimpleNamespace):
    def __len__(self) -> int:
        return len(self.setpoints)


def rows(setpoints: np.ndarray, readback: np.ndarray) -> Any:
    applied = np.diff(setpoints, axis=0, append=setpoints[-1:])
    return cast("Any", Rows(setpoints=setpoints, readback=readback, applied=applied))


def test_rows_of_a_corrector_that_follows_teach():
    setpoints = np.cumsum(np.random.default_rng(0).standard_normal((50, 3)), axis=0)
    late = np.concatenate((setpoints[:1], setpoints[:-1]))
    assert not astray(rows(setpoints, late), S).any()
    assert not astray(rows(setpoints[:0], setpoints[:0]), S).any()


def test_rows_of_a_stuck_corrector_do_not_teach_until_it_is_left_alone():
    setpoints = np.cumsum(np.ones((50, 3)), axis=0)
    setpoints[30:, 1] = setpoints[30, 1]  # left out from here on
    readback = setpoints.copy()
    readback[20:, 1] = setpoints[20, 1]
    refused = astray(rows(setpoints, readback), S)
    assert refused[20:30].all() and not refused[:18].any() and not refused[31:].any()


def test_the_moment_in_which_a_corrector_fails_or_returns_does_not_teach():
    setpoints = np.cumsum(np.ones((50, 3)), axis=0)
    setpoints[:, 2] = 7.0
    readback = setpoints.copy()
    readback[10:40, 2] = np.nan
    refused = astray(rows(setpoints, readback), S)
    assert np.flatnonzero(refused).tolist() == [8, 9, 10, 38, 39, 40]
    off = InterlockSettings(readback_tolerance=None)
    assert not astray(rows(setpoints, readback), off).any()
