"""Every effect, simulated and recovered: its value, its interval, its likelihood.

The plant simulates tick by tick, the hooks tell a whole record at once, the fit begins at values
that are half as large again (those that are chosen among needles, at what the scan proposes).
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.recover import Case, away, draw, propose, record_of, refine
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.fit_scores import by_row
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.problem import from_fitted, to_fitted
from orbitfb.diagnose.random_values import likelihood_of, state
from orbitfb.diagnose.strike_scan import latent_gain
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.registry import all_effects

TICKS = 700
SEED = 1
WIDER = 2.576 / 1.645
"""A 99 % interval over the 90 % one that is stated."""
BY_SCAN = {"corrector-quantisation", "ground-motion-level"}
"""Effects whose value the scan finds: the needles of a comb, and the level of a whole ring."""
SCREENED = {"bpm-stuck"}
"""Exact repeats are found by the integrity screen, not by a likelihood."""
KINDS = {name: kind for name, kind in all_effects().items() if name not in SCREENED}
each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))


@pytest.fixture(scope="module")
def benches():
    """One record and bench per kind, made once."""
    made: dict[str, tuple[Case, Bench]] = {}

    def of(kind) -> tuple[Case, Bench]:
        if kind.id not in made:
            case = draw(kind, SEED, TICKS, later=False)
            made[kind.id] = case, Bench(record_of(case, TICKS), background=0.0)
        return made[kind.id]

    return of


def widened(parameter, value, low, high):
    """Ends of the 99 % interval that belongs to a 90 % one."""
    centre = to_fitted(parameter, value)
    ends = (centre + WIDER * (to_fitted(parameter, end) - centre) for end in (low, high))
    least, most = (from_fitted(parameter, end) for end in ends)
    return least - 1e-9 * abs(value), most + 1e-9 * abs(value)


def course_values(bench, cause):
    found = refine(bench, cause)
    assert found.gain > 20.0
    return found.causes[0].values, [found.interval(i) for i in range(len(found.parameters))]


@pytest.mark.nightly
@each_kind
def test_what_was_simulated_is_recovered_within_its_interval(kind, benches):
    case, bench = benches(kind)
    start = propose(bench, kind)[0].cause if kind.id in BY_SCAN else away(case.truth)
    if isinstance(kind, NoiseKind | LatentKind):
        stated = state(bench, start)
        values = stated.cause.values
        intervals = [stated.intervals[p.name] for p in kind.parameters]
    else:
        values, intervals = course_values(bench, start)
    for parameter, (low, high) in zip(kind.fitted(bench.record), intervals, strict=True):
        true = case.truth.values[parameter.name]
        least, most = widened(parameter, values[parameter.name], low, high)
        assert least <= true <= most, f"{parameter.name} is {values[parameter.name]:g}"
        if true != parameter.nominal and parameter.name != "left":
            assert high - low < 0.9 * (parameter.high - parameter.low), "it says nothing"


@each_kind
def test_the_likelihood_moves_with_every_parameter(kind, benches):
    case, bench = benches(kind)
    if not kind.parameters:
        pytest.skip("it has no parameter")
    for parameter in kind.fitted(bench.record):
        if parameter.name == "dnu_y" or parameter.name == "rate_y":
            continue  # one plane is recorded
        true = case.truth.values[parameter.name]
        step = 1.0 if parameter.whole else 0.5 * abs(true)
        heights = [
            height(bench, replace(case.truth, values={**case.truth.values, parameter.name: at}))
            for at in (true, max(true - step, parameter.low), min(true + step, parameter.high))
        ]
        assert len({round(h, 3) for h in heights}) > 1, parameter.name
        assert np.isfinite(heights).all()


@each_kind
def test_nominal_values_change_nothing(kind, benches):
    case, bench = benches(kind)
    if not kind.parameters or not kind.vanishes or isinstance(kind, NoiseKind | LatentKind):
        pytest.skip("it has no size without effect, or no course in time")
    nominal = {p.name: p.nominal for p in kind.parameters}
    white, _, jacobian = bench.residual((replace(case.truth, values=nominal),))
    # What is left may be told over another level of a BPM's noise; every row is as likely.
    rows = by_row(white, jacobian) - by_row(bench.white, bench.jacobian)
    np.testing.assert_allclose(rows, 0.0, atol=1e-9)
    if not (isinstance(kind, SensorKind) and (kind.scales or kind.colours)):
        np.testing.assert_array_equal(white, bench.white)
        np.testing.assert_array_equal(jacobian, bench.jacobian)


def height(bench, cause):
    """Log-likelihood up to a constant."""
    if cause.kind.id == "ground-motion-level":
        floor = bench.floor
        walk = cause.values["factor"] ** 2 * floor.walk
        other = NoiseFloor(floor.modes, floor.reading, walk)
        return bench.with_floor(other).full_log_likelihood
    if isinstance(cause.kind, NoiseKind):
        return likelihood_of(bench, cause)(cause.values)
    if isinstance(cause.kind, LatentKind):
        return float(np.sum(latent_gain(bench, cause.kind, cause.values, cause.places)))
    return log_likelihood(*bench.residual((cause,)))
