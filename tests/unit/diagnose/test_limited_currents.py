"""Currents that are limited on one side alone, or softly."""

import numpy as np
import pytest
from test_scans import CORRECTORS, LAYOUT, RING, best, record_with

from orbitfb.diagnose.answer_parts import ParameterValue
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.wording import parameter
from orbitfb.effects.actuating import ColumnsEffect
from orbitfb.effects.registry import all_effects

DITHER = 3e-3
SATURATION = all_effects()["corrector-saturation"]


@pytest.mark.parametrize("side", [2, -2])
def test_it_is_found_with_its_side(side):
    """A limit that keeps a current away from zero, which is none of its size."""
    quiet = simulate_record(RING, "x", 700, 5, dither=DITHER, period=LAYOUT.period).setpoints
    away = np.sign(side) * quiet.mean(axis=0)
    column = int(np.argsort(away)[9])
    edge = abs(float(np.quantile(quiet[:, column], 0.8 if side > 0 else 0.2)))
    name = CORRECTORS[column]
    wrong = f"corrector-saturation:limit={edge:.5f}A,side={side},names={name}"
    record = record_with(wrong, dither=DITHER)
    assert best(record, "corrector-saturation").cause.values["side"] == side
    (one,) = search(record, [SATURATION]).winners
    cause, fitted = one.accepted.cause, one.accepted.fit
    assert (cause.places, cause.values["side"]) == ((column,), side)
    low, high = fitted.interval(0)
    assert low <= edge <= high
    assert high - low < 0.1 * np.ptp(quiet[:, column])


def test_a_choice_is_told_in_words():
    which = SATURATION.parameters[1]
    assert {abs(value) for value in which.meanings} == {0, 1, 2}
    told = ParameterValue(value=2.0, unit="1", meaning=which.meanings[2])
    assert parameter(told) == "2 (θ ≤ −m)"


class _Iron(ColumnsEffect):
    """Kicks of iron that saturates: θ = L tanh(u/L)."""

    def __init__(self, column: int, limit: float) -> None:
        super().__init__(np.array([column]))
        self.limit = limit

    def follow(self, wanted):
        return self.limit * np.tanh(wanted / self.limit)


def test_iron_that_saturates_is_a_limit_with_a_round_corner():
    quiet = simulate_record(RING, "x", 700, 5, dither=DITHER, period=LAYOUT.period).setpoints
    column = int(np.argsort(np.abs(quiet.mean(axis=0)))[-9])
    iron = _Iron(column, 1.1 * float(np.abs(quiet[:, column]).max()))
    record = simulate_record(RING, "x", 700, 5, [iron], dither=DITHER, period=LAYOUT.period)
    kinds = [SATURATION, all_effects()["corrector-gain"], all_effects()["corrector-hysteresis"]]
    (one,) = search(record, kinds).winners
    assert (one.accepted.kind.id, one.accepted.cause.places) == (SATURATION.id, (column,))
    low, high = one.accepted.fit.interval(1)
    assert low > 0.01 * iron.limit
    assert high < iron.limit
