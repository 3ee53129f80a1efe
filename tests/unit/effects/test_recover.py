"""Every effect, simulated tick by tick, and found by its law, which tells a record at once."""

import numpy as np
import pytest

from benchmarks.recover import SCREENED, Case, columns_of, draw, record_of, recover
from benchmarks.small_ring import small_ring
from orbitfb.diagnose.experiments.suspects import Change, Suspect, change_of
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import Signals
from orbitfb.effects.registry import all_effects, effect
from orbitfb.estimation.transform import StepTransform

RING = small_ring()
TICKS = 1000
QUICK = ("bpm-offset", "noise-correlated")
"""A law and a noise, in every run of the tests; the others at night."""
SLOW = (
    "bpm-current",
    "bpm-gain",
    "bpm-hum",
    "bpm-lowpass",
    "bpm-nonlinearity",
    "bpm-roll",
    "bpm-walk",
    "corrector-crosstalk",
    "corrector-gain",
    "corrector-deadband",
    "corrector-hysteresis",
    "corrector-roll",
    "energy-ramp",
    "loop-delay",
    "missed-write",
    "periodic-disturbance",
    "quadrupole-gradient",
    "sextupole",
    "skew-coupling",
    "telegraph",
)
KINDS = {name: kind for name, kind in all_effects().items() if name not in SCREENED}
each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(name, marks=pytest.mark.nightly) for name in SLOW)]
)
def test_what_was_simulated_is_found_at_its_place_with_its_size(name: str) -> None:
    case = draw(effect(name), 1, TICKS, RING)
    found = recover(case, TICKS)
    assert found.first == name
    if case.places:
        if not hasattr(case.kind, "patterns"):
            assert found.places(case)
        assert found.accepted[0].places
    size = case.kind.linear or case.kind.parameters[0].name
    assert found.accepted[0].values[size] == pytest.approx(case.values[size], rel=0.5)


def signals_of(kind: EffectKind) -> tuple[Case, Signals, StepTransform]:
    """A record of the effect, its readings taken for the predicted orbit."""
    case = draw(kind, 1, 200, RING)
    record = record_of(case, 200)
    return case, Signals(record, record.setpoints, record.readings), StepTransform.of(record.starts)


def change(case: Case, values: Values, signals: Signals, transform: StepTransform) -> Change | None:
    places = case.places
    if case.kind.target in ("bpm", "corrector"):
        columns = columns_of(case.kind, places, signals.record.layout)
        places = tuple(int(column) for column in columns)
    return change_of(Suspect(case.kind, places, values), signals, transform)


@each_kind
def test_its_law_moves_with_every_parameter_and_nominal_values_change_nothing(
    kind: EffectKind,
) -> None:
    case, signals, transform = signals_of(kind)
    true = {p.name: case.values.get(p.name, p.typical) for p in kind.parameters}
    now = change(case, true, signals, transform)
    if now is None:
        pytest.skip("it is random: it has no course in time")
    if case.onset and not np.any(now.field):
        pytest.skip("it is a step: nothing is seen of it but its onset")
    for parameter in kind.fitted(signals.record):
        if parameter.name in ("dnu_y", "rate_y") or parameter.meanings or parameter.optional:
            continue  # one plane is recorded; choices and refinements need not show here
        step = 1.0 if parameter.whole else 0.5 * abs(true[parameter.name])
        down = {**true, parameter.name: max(true[parameter.name] - step, parameter.low)}
        moved = change(case, down, signals, transform)
        assert moved is not None
        assert np.any(moved.field != now.field), parameter.name
    if kind.parameters and kind.id != "corrector-stuck":  # stuck devices leave something
        nominal = change(case, {p.name: p.nominal for p in kind.parameters}, signals, transform)
        assert nominal is not None
        assert np.abs(nominal.field).max() <= 1e-9 * np.abs(now.field).max()
