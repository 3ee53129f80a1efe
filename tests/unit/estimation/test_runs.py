"""Strikes that follow each other, against the sum over all their courses."""

import itertools

import numpy as np
import pytest

from orbitfb.estimation.runs import evidence_of_runs, likeliest_runs

ROWS, LONGEST = 8, 3


def _runs(struck: tuple[bool, ...]) -> list[int]:
    """Length of the run of strikes that every row ends."""
    found = [0]
    for one in struck:
        found.append(found[-1] + 1 if one else 0)
    return [min(one, LONGEST) for one in found[1:]]


def _log_densities(gains: np.ndarray, share: float) -> dict[tuple[int, ...], float]:
    """Log density of every course of strikes over that of none of them being possible."""
    found = {}
    for struck in itertools.product((False, True), repeat=ROWS):
        runs = _runs(struck)
        worth = sum(float(gains[run - 1, row]) for row, run in enumerate(runs) if run)
        count = sum(struck)
        found[tuple(runs)] = worth + count * np.log(share) + (ROWS - count) * np.log1p(-share)
    return found


@pytest.mark.parametrize("share", [0.01, 0.2, 0.6])
def test_runs_are_those_of_all_courses(share: float) -> None:
    """The evidence is the sum over all courses, the likeliest course the largest of them."""
    gains = np.random.default_rng(3).normal(0.0, 4.0, (LONGEST, ROWS))
    every = _log_densities(gains, share)

    evidence = evidence_of_runs(gains, np.array([0.5, share]))

    assert evidence[1] == pytest.approx(float(np.logaddexp.reduce(list(every.values()))), rel=1e-12)
    assert tuple(likeliest_runs(gains, share)) == max(every, key=lambda runs: every[runs])


def test_certain_strikes_do_not_overflow() -> None:
    """Ratios beyond what a number holds are told as certain."""
    gains = np.full((LONGEST, ROWS), -1e6)
    gains[0, 3] = 1e6

    evidence = evidence_of_runs(gains, np.array([0.1]))

    assert np.isfinite(evidence).all()
    assert list(likeliest_runs(gains, 0.1)) == [0, 0, 0, 1, 0, 0, 0, 0]
