"""What every registered effect must keep to, whatever it does."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from orbitfb.effects.build import layout_of
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.element_kinds import ElementsKind
from orbitfb.effects.kinds import FIRST_STATE, Stage, Target
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import describe, keys
from orbitfb.physics.effect import generator
from orbitfb.physics.places import Ring
from orbitfb.records.record import Record

KINDS = all_effects()
ROWS = 60
PAGES = Path(__file__).parents[3] / "docs/reference/effects"
ALWAYS_THERE = {"corrector-stuck"}
"""Their parameters say how, not how much: they have no size without effect."""
each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))


@pytest.fixture(scope="module")
def layout():
    return layout_of(Ring.load(), "xy", 0.1)


@pytest.fixture(scope="module")
def setpoints(layout):
    """A course with steps, small changes and reversals, shape (ROWS, m) [A]."""
    rng = np.random.default_rng(1)
    m = len(layout.correctors)
    steps = 0.3 * rng.standard_normal((ROWS, m)) * (rng.random((ROWS, 1)) < 0.2)
    return np.cumsum(steps + 0.01 * rng.standard_normal((ROWS, m)), axis=0)


@pytest.fixture(scope="module")
def record(layout, setpoints):
    """What the nominal ring makes of them, in two stretches."""
    rng = np.random.default_rng(2)
    time = 0.1 * np.arange(ROWS)
    readings = setpoints @ layout.response.T
    requested = np.full_like(setpoints, np.nan)
    requested[:-1] = np.diff(setpoints, axis=0)
    starts = np.isin(np.arange(ROWS), (0, 25))
    return Record(
        layout=layout,
        time=time,
        starts=starts,
        readings=readings + 0.2e-6 * rng.standard_normal(readings.shape),
        setpoints=setpoints,
        requested=requested,
        readback=setpoints.copy(),
        dither=np.zeros_like(setpoints),
        reference=np.zeros_like(readings),
        filled=np.zeros(readings.shape, dtype=bool),
        auxiliary={
            "current": 0.4 + 0.004 * np.sin(time),
            "rf_frequency": 499.68e6 + 10.0 * np.sin(time),
        },
        source="test",
        digest="0" * 64,
    )


def nominal(kind):
    return {p.name: p.nominal for p in kind.parameters}


def typical(kind, **others):
    return {p.name: p.typical for p in kind.parameters} | others


def some_places(kind, layout):
    if kind.target == "ring":
        return np.zeros(0, dtype=np.intp)
    if isinstance(kind, PairKind):
        return np.array(kind.pairs(layout)[0], dtype=np.intp)
    return np.arange(3)


class ChangedError(AssertionError):
    pass


def untouched(hook, *arrays):
    before = [array.copy() for array in arrays]
    answer = hook(*arrays)
    for array, copy in zip(arrays, before, strict=True):
        if not np.array_equal(array, copy):
            raise ChangedError(f"{hook} changed an array that it was given")
    return answer


def run(effect, layout, setpoints):
    """Readings and currents of the plant with one effect, watching that it changes no argument."""
    readings, all_currents = [], []
    rng = np.random.default_rng(3)
    noise, steps = 1e-6 * rng.standard_normal((2, len(setpoints), len(layout.bpms)))
    motion = np.cumsum(steps, axis=0)
    for tick, wanted in enumerate(setpoints):
        currents = untouched(lambda u, t=tick: effect.actuate(u, t), wanted)
        orbit = layout.response @ currents
        orbit = untouched(lambda x, u, t=tick: effect.respond(x, u, t), orbit, currents)
        orbit = untouched(lambda x, t=tick: effect.disturb(x, t), orbit + motion[tick])
        readings.append(untouched(lambda x, t=tick: effect.sense(x, t), orbit + noise[tick]).copy())
        all_currents.append(currents.copy())
    return np.array(readings), np.array(all_currents)


def simulated(kind, values, layout, setpoints, seed=1):
    rng = generator(seed, kind.id)
    effect = kind.simulate(layout, some_places(kind, layout), values, rng)
    return run(effect, layout, setpoints)


@pytest.fixture(scope="module")
def bare(layout, setpoints):
    from orbitfb.physics.effect import Effect

    return run(Effect(), layout, setpoints)


def test_there_are_effects():
    assert len(KINDS) > 20
    assert {kind.stage for kind in KINDS.values()} == set(get_args(Stage))


@each_kind
def test_it_tells_of_itself(kind):
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", kind.id)
    assert kind.stage in get_args(Stage)
    assert kind.target in get_args(Target)
    assert kind.title
    assert kind.sentence.endswith(".")
    assert len(kind.sentence) > 20
    assert kind.equation
    assert set(kind.confused_with) <= set(KINDS) - {kind.id}
    assert not kind.confused_with or kind.splits
    assert not kind.splits or (kind.splits[0].isupper() and kind.splits.endswith("."))


@each_kind
def test_its_parameters_are_sane(kind):
    names = [p.name for p in kind.parameters]
    assert len(set(names)) == len(names)
    assert not set(names) & set(keys())
    assert kind.linear is None or kind.linear in names
    for p in kind.parameters:
        assert re.fullmatch(r"[a-z][a-z_0-9]*", p.name)
        assert np.isfinite([p.low, p.high, p.nominal, p.typical]).all()
        assert p.low < p.high, describe(p)
        # what runs by orders of magnitude never reaches the 0 where it is not there
        assert p.low <= p.nominal <= p.high or (p.log and p.nominal == 0.0), describe(p)
        assert p.low <= p.typical <= p.high, describe(p)
        assert p.description
        assert p.unit
    if kind.parameters and kind.id not in ALWAYS_THERE:
        assert kind.parameters[0].typical != kind.parameters[0].nominal


@each_kind
def test_its_grid_is_made_of_its_parameters(kind, record):
    grid = list(kind.grid(record))
    assert len(grid)
    for values in grid:
        assert set(values) == {p.name for p in kind.parameters}
        for p in kind.parameters:
            assert p.low <= values[p.name] <= p.high, describe(p)


@each_kind
def test_without_size_it_is_the_nominal_plant(kind, layout, setpoints, bare):
    if not kind.parameters or kind.id in ALWAYS_THERE:
        pytest.skip("it has no size")
    readings, currents = simulated(kind, nominal(kind), layout, setpoints)
    np.testing.assert_array_equal(readings, bare[0])
    np.testing.assert_array_equal(currents, bare[1])


@each_kind
def test_with_a_size_the_plant_changes_and_comes_again_from_the_seed(kind, layout, setpoints, bare):
    values = typical(kind)
    readings, _ = simulated(kind, values, layout, setpoints)
    if np.array_equal(readings, bare[0]):  # rare, or below a threshold: as much as there may be
        values = typical(kind, **{kind.parameters[0].name: kind.parameters[0].high})
        readings, _ = simulated(kind, values, layout, setpoints)
    assert np.isfinite(readings).all()
    assert not np.array_equal(readings, bare[0])
    again, _ = simulated(kind, values, layout, setpoints)
    np.testing.assert_array_equal(again, readings)


@each_kind
def test_it_stays_where_it_is_put(kind, layout, setpoints, bare):
    if kind.target not in ("bpm", "corrector") or isinstance(kind, PairKind):
        pytest.skip("it acts beyond its place")
    readings, currents = simulated(kind, typical(kind), layout, setpoints)
    others = np.arange(3, len(layout.bpms))
    if kind.target == "bpm":
        np.testing.assert_array_equal(readings[:, others], bare[0][:, others])
    else:
        np.testing.assert_array_equal(currents[:, others], bare[1][:, others])


@each_kind
def test_what_some_devices_do_follows_from_their_own_columns(kind, record):
    signals = Signals(record, record.setpoints, record.readings)
    laws = [one for one in kind.laws(signals) if isinstance(one, DeviceLaw) and one.some]
    if not laws:
        pytest.skip("its devices do not act alone")
    (law,), some = laws, np.array([4, 1])
    for values in (*kind.grid(record)[:3], *kind.own_grid(record)[-1:]):
        wide = values | (
            {FIRST_STATE: np.linspace(-1, 1, len(law.names))} if kind.remembers else {}
        )
        own = {name: one[some] if np.ndim(one) else one for name, one in wide.items()}
        given = law.some(signals, some)
        for whole, part in zip(law.course(wide, signals), law.course(own, given), strict=True):
            chosen = whole if whole.shape[1] == 1 else whole[:, some]
            np.testing.assert_array_equal(part, chosen)
        if law.first is not None:
            np.testing.assert_array_equal(law.first(own, given), law.first(wide, signals)[:, some])


@each_kind
def test_without_size_its_hook_does_nothing(kind, layout, record):
    values = nominal(kind)
    currents, orbit = record.setpoints, record.readings
    if not kind.parameters or kind.id in ALWAYS_THERE:
        pytest.skip("it has no size")
    if isinstance(kind, ActuatorKind):
        driven = untouched(lambda u: kind.drive(u, values, record), currents)
        np.testing.assert_array_equal(driven, currents)
    elif isinstance(kind, SensorKind):
        distorted = untouched(lambda x: kind.distort(x, values, record), orbit)
        np.testing.assert_array_equal(distorted, orbit)
    elif isinstance(kind, SourceKind):
        assert not np.any(kind.drivers(values, record, currents, orbit))
    elif isinstance(kind, RingKind):
        assert not np.any(kind.deflect(values, record, currents, orbit))
    elif isinstance(kind, NoiseKind):
        assert kind.variance(values, 0.2e-6) == 0.0
    elif isinstance(kind, PairKind):
        np.testing.assert_array_equal(kind.matrix(values), np.eye(2))
    else:
        assert isinstance(kind, LatentKind | ElementsKind)


@each_kind
def test_with_a_size_its_hook_does_something(kind, layout, record):
    currents, orbit = record.setpoints, record.readings
    first = kind.parameters[0] if kind.parameters else None
    answers = []
    for values in (typical(kind), typical(kind, **({first.name: first.high} if first else {}))):
        if isinstance(kind, ActuatorKind):
            answers.append(kind.drive(currents, values, record) - currents)
        elif isinstance(kind, SensorKind):
            there = kind.distort(orbit, values, record)
            answers.append(there - orbit)
        elif isinstance(kind, SourceKind):
            answers.append(kind.drivers(values, record, currents, orbit))
        elif isinstance(kind, RingKind):
            answers.append(kind.deflect(values, record, currents, orbit))
        elif isinstance(kind, NoiseKind):
            answers.append(np.array(kind.variance(values, 0.2e-6)))
        elif isinstance(kind, PairKind):
            answers.append(kind.matrix(values) - np.eye(2))
        elif isinstance(kind, ElementsKind):
            effect = kind.simulate(layout, np.arange(3), values, np.random.default_rng(0))
            answers.append(effect.respond(np.zeros(len(layout.bpms)), currents[-1], 0))
        else:
            answers.append(kind.shapes(record, currents, orbit))
    assert all(np.isfinite(answer).all() for answer in answers)
    assert any(np.any(answer) for answer in answers)


@each_kind
def test_its_page_is_there(kind):
    assert (PAGES / f"{kind.id}.md").is_file(), "run `.venv/bin/python docs/generate.py`"


# Still to come here, with the engine: simulate → recover within the stated interval, and
# parameter moved → likelihood moves, for every effect.
