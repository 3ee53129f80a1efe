"""Effects of correctors: what a record is told against what the plant does, and closed forms."""

import numpy as np
import pytest
from actuator_courses import PLACES, ROWS, course, driven, few, nominal, record_of, simulated
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from orbitfb.core.errors import ConfigError
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.registry import effect
from orbitfb.physics.plant import Plant, PlantSettings

# several sizes each: well below, around and above the changes of the courses (some mA)
SIZES = {
    "corrector-gain": [{"gain": 0.3}, {"gain": -0.9}],
    "corrector-polarity": [{}],
    "corrector-stuck": [{"left": 1.0}, {"left": 0.0}, {"left": 0.4}],
    "corrector-slew": [{"rate": 1e-3}, {"rate": 0.02}, {"rate": 0.08}],
    "corrector-lag": [
        {"tau": tau, "second": second} for tau in (0.03, 0.1, 3.0) for second in (1e-6, 0.1)
    ],
    "corrector-resonance": [
        {"frequency": 0.3, "damping": 0.05},
        {"frequency": 4.0, "damping": 0.3},
        {"frequency": 17.0, "damping": 0.01},
        {"frequency": 1.0, "damping": 1.0},
        {"frequency": 2.0, "damping": 2.5},
    ],
    "corrector-quantisation": [{"step": 1e-4}, {"step": 3e-3}, {"step": 1.0}],
    "corrector-deadband": [{"width": 5e-4}, {"width": 3e-3}, {"width": 0.02}],
    "corrector-saturation": [
        {"limit": limit, "side": side, "rounding": rounding}
        for limit, side in ((0.01, 0), (0.04, 0), (0.0, 0), (0.002, 1), (0.001, 2), (0.02, -2))
        for rounding in (1e-6, 1e-3)
    ],
    "corrector-hysteresis": [
        {"width": 1e-3, "share": 1.0},
        {"width": 8e-3, "share": 0.3},
        {"width": 0.03, "share": -0.5},
    ],
}
DELAYS = [{"ticks": 0.4}, {"ticks": 1.0}, {"ticks": 2.75}]
CASES = [(name, values) for name, sizes in SIZES.items() for values in sizes]
CASES += [("loop-delay", values) for values in DELAYS]
LOWER = ("corrector-saturation", {"limit": 0.002, "side": -1, "rounding": 1e-6})
"""It touches but one of three courses."""
PAIRS = {
    "corrector-swap": {},
    "corrector-crosstalk": {"share": 0.3},
    "corrector-roll": {"angle": 0.2},
}


def test_every_actuator_effect_is_in_these_tests():
    modules = [*SIZES, *PAIRS, "loop-delay", "missed-write"]
    assert len(modules) == 15
    assert all(effect(name).id == name for name in modules)


@pytest.mark.parametrize(("name", "values"), [*CASES, LOWER])
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_record_is_told_what_the_plant_does(layout, name, values, seed):
    kind, small = effect(name), few(layout)
    setpoints = course(seed, 8)
    told = driven(kind, small, values, setpoints)
    assert told.shape == setpoints.shape
    places = np.arange(0) if kind.target == "ring" else PLACES
    assert_allclose(told, simulated(kind, small, values, setpoints, places), rtol=0, atol=1e-13)
    if kind.target != "ring":
        others = np.setdiff1d(np.arange(8), PLACES)
        assert_array_equal(told[:, others], setpoints[:, others])


@pytest.mark.parametrize(("name", "values"), CASES)
def test_it_does_something(layout, name, values):
    kind, small, setpoints = effect(name), few(layout), course(3, 8)
    told = driven(kind, small, values, setpoints)
    columns = slice(None) if kind.target == "ring" else PLACES
    assert np.all(np.max(np.abs(told - setpoints)[:, columns], axis=0) > 1e-6)


@pytest.mark.parametrize("name", [*SIZES, "loop-delay"])
def test_nominal_values_leave_everything_as_it_is(layout, name):
    kind, small, setpoints = effect(name), few(layout), course(1, 8)
    if name in ("corrector-polarity", "corrector-stuck"):
        return
    assert_array_equal(driven(kind, small, nominal(kind), setpoints), setpoints)
    assert_array_equal(simulated(kind, small, nominal(kind), setpoints), setpoints)


@pytest.mark.parametrize(("name", "values"), CASES)
def test_memory_begins_anew_in_every_stretch(layout, name, values):
    kind, small = effect(name), few(layout)
    setpoints = course(4, 8)
    told = driven(kind, small, values, setpoints, starts=(0, 60))
    if name == "corrector-stuck":  # a gap in the record frees nothing
        assert_array_equal(told[60:, PLACES], told[:90, PLACES])
        return
    if kind.remembers:  # and moves nothing
        assert_array_equal(told, driven(kind, small, values, setpoints))
        return
    apart = [driven(kind, small, values, part) for part in (setpoints[:60], setpoints[60:])]
    assert_allclose(told, np.concatenate(apart), rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", [*SIZES, *PAIRS, "loop-delay", "missed-write"])
def test_it_tells_what_it_is(layout, both_planes, name):
    kind = effect(name)
    planes = both_planes if name == "corrector-roll" else layout
    record = record_of(planes, course(0, len(planes.correctors), rows=50))
    assert kind.unavailable(record) == ""
    assert kind.title[0].islower()
    assert kind.sentence.endswith(".")
    assert kind.splits.endswith(".")
    assert kind.linear is None or kind.linear in [its.name for its in kind.parameters]
    for its in kind.parameters:
        assert its.low <= its.nominal <= its.high
        assert its.low <= its.typical <= its.high
        assert its.description.endswith(".")
    sets = kind.grid(record)
    for values in sets:
        assert set(values) == {p.name for p in kind.parameters}
        assert all(p.low <= values[p.name] <= p.high for p in kind.parameters)
    assert 1 <= len(sets) <= 40


@pytest.mark.parametrize("size", [1e-5, 1e-3, 0.1])
@pytest.mark.parametrize(
    "name",
    ["corrector-slew", "corrector-deadband", "corrector-hysteresis", "corrector-saturation"],
)
def test_the_grid_of_a_hard_effect_follows_the_size_of_the_record(layout, name, size):
    kind = effect(name)
    setpoints = course(5, 180, rows=400, size=size) - course(5, 180, rows=400, size=size)[0]
    record = record_of(layout, setpoints)
    moved = [kind.drive(setpoints, values, record) - setpoints for values in kind.grid(record)]
    shares = np.sort([np.sqrt(np.mean(its**2)) / np.std(setpoints) for its in moved])
    assert shares[0] < 0.02  # one that hardly acts
    assert shares[-1] > 0.25  # one that keeps the correctors from much that they should do
    between = shares[(shares > 0.02) & (shares < 0.25)]
    assert len(between) >= 4
    assert np.max(between[1:] / between[:-1]) < 2.5  # and no hole between


def test_a_pair_is_told_as_the_plant_mixes_it(layout, both_planes):
    for name, values in PAIRS.items():
        kind = effect(name)
        its = both_planes if name == "corrector-roll" else layout
        assert isinstance(kind, PairKind)
        setpoints = course(7, len(its.correctors), rows=20)
        pairs, matrices = kind.pairs(its), kind.matrices(its, values)
        assert matrices.shape == (len(pairs), 2, 2)
        for number in (0, len(pairs) // 2, len(pairs) - 1):
            pair, struck = pairs[number], np.array(kind.struck(pairs)[number])
            want = setpoints.copy()
            want[:, pair] = setpoints[:, pair] @ matrices[number].T
            got = simulated(kind, its, values, setpoints, places=struck)
            assert_allclose(got, want, rtol=0, atol=1e-15)
            assert np.max(np.abs(got - setpoints)) > 1e-4


def test_pairs_without_size_do_nothing(layout, both_planes):
    for name in ("corrector-crosstalk", "corrector-roll"):
        kind = effect(name)
        assert_array_equal(kind.matrix(nominal(kind)), np.eye(2))
        setpoints = course(8, 360, rows=5)
        pair = kind.pairs(both_planes)[3]
        assert_array_equal(
            simulated(kind, both_planes, nominal(kind), setpoints, places=pair), setpoints
        )


def test_which_pairs_there_are(layout, both_planes):
    assert len(effect("corrector-swap").pairs(layout)) == 180 * 179 // 2
    assert len(effect("corrector-crosstalk").pairs(layout)) == 180 * 179
    assert len(effect("corrector-roll").pairs(layout)) == 0
    assert len(effect("corrector-swap").pairs(both_planes)) == 180 * 179 + 180
    roll = effect("corrector-roll").pairs(both_planes)
    names, planes = both_planes.correctors.names, both_planes.correctors.planes
    assert len(roll) == 3 * 180  # the magnet, or the coil of one plane
    struck = effect("corrector-roll").struck(roll)
    assert struck[7] == (7, 187)
    assert struck[187] == (7,)
    assert struck[367] == (187,)
    assert all(names[x] == names[y] and planes[x] == "x" and planes[y] == "y" for x, y in roll)
    talk = effect("corrector-crosstalk").pairs(both_planes).tolist()
    cells = both_planes.correctors.cells
    across = [(a, b) for a, b in talk if planes[a] != planes[b]]
    assert [0, 180] not in talk and [180, 0] not in talk  # that is a roll
    assert all(cells[a] == cells[b] for a, b in across)
    assert len(across) == 180 * 5 * 2  # six correctors in a cell


def test_a_roll_turns_kicks_and_not_currents(ring, both_planes):
    """The kick keeps its size, and goes over into the other plane with the tangent of φ."""
    kind, quiet = (
        effect("corrector-roll"),
        PlantSettings(bpm_noise_rms=0, ground_motion_rms=0, initial_orbit_rms=0),
    )
    column, angle = 4, 0.3
    kick_x, kick_y = ring.calibration("x")[column], ring.calibration("y")[column]
    assert abs(kick_x / kick_y - 1) > 0.05
    made = kind.simulate(
        both_planes, np.array([column]), {"angle": angle}, np.random.default_rng(0)
    )
    setpoints = np.zeros(360)
    setpoints[column] = 0.1
    orbit = Plant(ring, "xy", quiet, 0, [made]).step(setpoints).true_orbit
    per_kick_x = both_planes.response[:180, column] / kick_x
    per_kick_y = both_planes.response[180:, 180 + column] / kick_y
    assert_allclose(orbit[:180], per_kick_x * kick_x * 0.1 * np.cos(angle), rtol=1e-12)
    assert_allclose(orbit[180:], per_kick_y * kick_x * 0.1 * np.sin(angle), rtol=1e-12)


def test_couples_of_correctors_must_be_couples(layout):
    for name in ("corrector-swap", "corrector-crosstalk"):
        with pytest.raises(ConfigError, match="two by two"):
            simulated(effect(name), layout, PAIRS[name], course(0, 180, rows=2), places=PLACES)
    with pytest.raises(ConfigError, match="both planes"):
        simulated(effect("corrector-roll"), layout, {"angle": 0.1}, course(0, 180, rows=2))


def test_a_missed_write_leaves_all_correctors_where_they_were(layout):
    kind, setpoints = effect("missed-write"), course(9, 180, rows=3000)
    got = simulated(kind, layout, {"probability": 0.05}, setpoints, places=np.arange(0))
    shapes = kind.shapes(record_of(layout, setpoints), setpoints, np.zeros((3000, 180)))
    missed = np.any(got != setpoints, axis=1)
    still = np.all(np.diff(setpoints, axis=0, prepend=np.nan) == 0, axis=1)
    lone = missed & ~np.roll(missed, 1) & ~np.roll(still, 1)
    assert 0.03 < np.mean(missed) / np.mean(~still) < 0.07
    assert_allclose((got - setpoints)[lone] @ layout.response.T, shapes[lone], rtol=0, atol=1e-15)
    assert_array_equal(got[1:][missed[1:]], got[:-1][missed[1:]])
    assert_array_equal(simulated(kind, layout, {"probability": 0.0}, setpoints), setpoints)
    starts = kind.shapes(record_of(layout, setpoints, (0, 100)), setpoints, shapes)
    assert_array_equal(starts[[0, 100]], 0.0)


def test_a_stuck_corrector_stays_where_it_was_when_it_began(layout):
    """For an onset the record from there on is given, and the plant calls from there on."""
    kind, setpoints = effect("corrector-stuck"), course(2, 180)
    record = record_of(layout, setpoints)
    later = kind.drive(setpoints[70:], {"left": 1.0}, record.rows(70, ROWS))
    assert_array_equal(later, np.broadcast_to(setpoints[70], later.shape))
    tripped = kind.drive(setpoints[70:], {"left": 0.0}, record.rows(70, ROWS))
    assert_array_equal(tripped, 0.0)


def test_a_tripped_current_falls_as_its_magnet_lets_it(layout):
    """L dI/dt = −R I from the tick before the onset on: by the tick T the current is exp(−T/τ)."""
    kind, setpoints = effect("corrector-stuck"), course(2, 180)
    values = {"left": 0.25, "decay": 0.3}
    later = record_of(layout, setpoints).rows(70, ROWS)
    told = kind.drive(setpoints[70:], values, later)
    since = layout.period * np.arange(1, len(told) + 1)[:, None]
    assert_allclose(told / setpoints[70], 0.25 + 0.75 * np.exp(-since / 0.3) + 0 * told, rtol=1e-9)
    plant = kind.simulate(layout, PLACES, values, np.random.default_rng(0))
    for row in range(30):
        current = plant.actuate(setpoints[70 + row], row)
        assert_allclose(current[PLACES], told[row, PLACES], rtol=1e-9)
    assert kind.long_after(values)["left"] == 0.25
    assert_allclose(
        kind.drive(setpoints[70:], kind.long_after(values), later),
        0.25 * setpoints[[70] * len(told)],
    )
