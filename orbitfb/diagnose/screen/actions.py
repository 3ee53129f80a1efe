"""Actions that are not those of the setpoints: another unit, another sign, another record."""

import numpy as np

from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.finding import Finding

_NEARLY = 0.95
_ABOUT = 0.05
"""Difference of two changes that are about the same, as a share of what was asked for."""
_FEWEST = 30
_LAGS = range(-8, 9)
"""Rows by which setpoints may be late or early and still follow the actions."""
_UNLIKE = 0.3
"""Correlation below which setpoints do not follow the actions, limits and all."""
_HALF = 0.5
"""Share of the actions that is surely not in the changes of the setpoints."""
_SURE = 3.0

_FACTORS = {
    1000.0: (
        "wrong-units",
        "1000 times the change of 'setpoint'",
        'is action in mA? Correct the array, or say so in meta: "units": {"action": "mA", '
        '"setpoint": "A"}',
    ),
    0.001: (
        "wrong-units",
        "0.001 times the change of 'setpoint'",
        'is setpoint in mA? Correct the array, or say so in meta: "units": {"action": "A", '
        '"setpoint": "mA"}',
    ),
    -1.0: (
        "wrong-sign",
        "the change of 'setpoint' with the opposite sign",
        "one of the two has the wrong sign; reverse it",
    ),
}


def other_actions(first: Indices, asked: Matrix, done: Matrix, exact: np.ndarray) -> list[Finding]:
    """Tell actions in another unit, with another sign, or of another record than the setpoints.

    Args:
        first: Row before every change, shape (K,).
        asked: Changes asked for, shape (K, m) [A].
        done: Changes of the setpoints, shape (K, m) [A].
        exact: What is nothing, of every corrector, shape (m,) [A].
    """
    meant = np.abs(asked) > exact
    if meant.any(axis=1).sum() < _FEWEST or not done.any():
        return []
    for factor, (check, what, advice) in _FACTORS.items():
        if _share(asked / factor, done, meant, exact / abs(factor)) > _NEARLY:
            text = f"'action' is {what} in (nearly) all rows: {advice}"
            return [Finding(check, "failure", (), None, text)]
    if _share(asked, done, meant, exact) < 1.0 - _NEARLY and _unlike(first, asked, done):
        text = (
            "the setpoints follow 'action' in (nearly) no row, and not a few rows earlier or later "
            "either: 'action' and 'setpoint' do not match. Give both for the same rows and with "
            "the columns in the same order, or leave 'action' out"
        )
        return [Finding("foreign-action", "failure", (), None, text)]
    return []


def _share(asked: Matrix, done: Matrix, meant: np.ndarray, exact: np.ndarray) -> float:
    """Share of the changes asked for that were about made."""
    same = np.abs(done - asked) <= _ABOUT * np.abs(asked) + exact
    return float(same[meant].mean())


def _unlike(first: Indices, asked: Matrix, done: Matrix) -> bool:
    """Whether the changes surely follow the actions at no lag.

    Where something else writes too they do, in the mean; where limits cut them off their signs do.
    """
    for lag in _LAGS:
        rows = slice(max(-lag, 0), len(first) - max(lag, 0))
        later = slice(max(lag, 0), len(first) - max(-lag, 0))
        joined = first[later] - first[rows] == lag
        moved, meant = done[later][joined], asked[rows][joined]
        size = float(np.sum(meant**2))
        if len(meant) < _FEWEST or not size:
            return False
        product = np.sum(meant * moved, axis=1)
        slope = float(product.sum()) / size
        rest = product - slope * np.sum(meant**2, axis=1)
        error = float(np.sqrt(np.sum(rest**2))) / size
        alike = float(product.sum()) / np.sqrt(size * float(np.sum(moved**2)) or 1.0)
        if abs(alike) > _UNLIKE or slope + _SURE * error > _HALF:
            return False
    return True
