"""Effects of sensors, noise and reading times: hooks of records against those of the plant."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from orbitfb.core.errors import ConfigError
from orbitfb.effects.registry import effect
from orbitfb.effects.sensors.bpm_current import top_up_current
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record

ROWS = 200
PLACES = np.array([3, 4, 50])
# a second stretch restarts memory; the values of each are far from nominal
SENSORS = {
    "bpm-gain": {"gain": 0.3},
    "bpm-polarity": {},
    "bpm-offset": {"offset": 20e-6},
    "bpm-drift": {"rate": 1e-6},
    "bpm-hum": {"cosine": 3e-6, "sine": -2e-6, "frequency": 1.3},
    "bpm-nonlinearity": {"quadratic": 800.0, "cubic": -2e6},
    "bpm-lowpass": {"tau": 0.2},
    "bpm-latency": {"ticks": 3.0},
    "bpm-current": {"slope": 1e-2},
}
UNDOABLE = [name for name in SENSORS if effect(name).undoable]
EXACT = 1e-13
"""What a curve is straightened to [m]; everything else is exact to rounding."""
NOISE = ("noise-level", "noise-correlated", "noise-coloured", "bpm-walk")


def record_of(layout, readings, starts=(0,)):
    rows = len(readings)
    begins = np.zeros(rows, dtype=bool)
    begins[list(starts)] = True
    setpoints = np.zeros((rows, len(layout.correctors)))
    time = np.arange(rows) * layout.period
    return Record(
        layout=layout,
        time=time,
        starts=begins,
        readings=readings,
        setpoints=setpoints,
        requested=setpoints,
        readback=None,
        dither=None,
        reference=None,
        filled=np.zeros(readings.shape, dtype=bool),
        auxiliary={"current": top_up_current(time)},
        source="test",
        digest="",
    )


def walk(layout, rows=ROWS, seed=0, size=30e-6):
    return (
        np.cumsum(np.random.default_rng(seed).standard_normal((rows, len(layout.bpms))), 0) * size
    )


def run(kind, layout, places, values, orbit, noise=None, seed=1):
    """What the plant's hooks make of an orbit, row by row; refuses changed arguments."""
    made = kind.simulate(layout, places, values, np.random.default_rng(seed))
    readings = np.empty_like(orbit)
    for tick, row in enumerate(orbit):
        true = row.copy()
        true.setflags(write=False)
        true = made.disturb(true, tick)
        read = true + (0.0 if noise is None else noise[tick])
        read.setflags(write=False)
        readings[tick] = made.sense(read, tick)
    return readings


def nominal(kind):
    return {p.name: p.nominal for p in kind.parameters}


@pytest.mark.parametrize("name", [*SENSORS, "bpm-stuck"])
def test_a_record_is_distorted_as_the_plant_distorts_it_tick_by_tick(layout, name):
    kind, values, orbit = effect(name), SENSORS.get(name, {}), walk(layout)
    readings = run(kind, layout, PLACES, values, orbit)
    record = record_of(layout, readings)
    expected = orbit.copy()
    expected[:, PLACES] = kind.distort(orbit[:, PLACES], values, record)
    assert_allclose(readings, expected, rtol=0, atol=1e-15)
    assert np.max(np.abs(readings - orbit)[:, PLACES]) > 1e-6


@pytest.mark.parametrize("name", UNDOABLE)
def test_restoring_gives_back_the_orbit(layout, name):
    kind, values, orbit = effect(name), SENSORS[name], walk(layout)
    record = record_of(layout, run(kind, layout, PLACES, values, orbit))
    restored, _ = kind.restore(record.readings[:, PLACES], values, record)
    assert_allclose(restored, orbit[:, PLACES], rtol=0, atol=EXACT)


@pytest.mark.parametrize("ticks", [0.3, 1.0, 2.6])
def test_readings_that_are_late_by_a_part_of_a_tick_have_noise_of_one_tick(layout, ticks):
    kind, orbit, whole = effect("bpm-latency"), walk(layout), int(ticks)
    noise = 0.2e-6 * np.random.default_rng(5).standard_normal(orbit.shape)
    readings = run(kind, layout, PLACES, {"ticks": ticks}, orbit, noise)[:, PLACES]
    record, own = record_of(layout, orbit), orbit[:, PLACES]
    at = np.arange(whole + 1, ROWS)
    expected = [np.interp(at - ticks, np.arange(ROWS), column) for column in own.T]
    late = kind.distort(own, {"ticks": ticks}, record)
    assert_allclose(late[at], np.transpose(expected), atol=1e-15)
    assert_allclose((readings - late)[at], noise[at - whole][:, PLACES], atol=1e-15)


@pytest.mark.parametrize("name", SENSORS)
def test_memory_restarts_with_every_stretch(layout, name):
    kind, values, orbit = effect(name), SENSORS[name], walk(layout)[:, PLACES]
    record = record_of(layout, walk(layout), (0, 60, 61, 130))
    distorted = kind.distort(orbit, values, record)
    undone = kind.restore(distorted, values, record) if name in UNDOABLE else None
    for piece in record.stretches:
        alone = record.rows(piece.start, piece.stop)
        # drift and current count from the first row of what they are given
        shift = distorted[piece][0] - kind.distort(orbit[piece], values, alone)[0]
        assert_allclose(
            distorted[piece] - shift, kind.distort(orbit[piece], values, alone), atol=1e-15
        )
        if undone is None:
            continue
        apart, own = kind.restore(distorted[piece] - shift, values, alone)
        assert_allclose(undone[0][piece], apart, rtol=0, atol=EXACT)
        assert_allclose(undone[1][piece], own)
        assert_allclose(apart, orbit[piece], rtol=0, atol=EXACT)


@pytest.mark.parametrize("name", [n for n in SENSORS if n != "bpm-polarity"])
def test_at_nominal_nothing_is_changed_to_the_last_digit(layout, name):
    kind, orbit = effect(name), walk(layout)
    record, values = record_of(layout, orbit, (0, 70)), nominal(kind)
    if name in UNDOABLE:
        restored, jacobian = kind.restore(orbit, values, record)
        assert_array_equal(restored, orbit)
        assert_array_equal(jacobian, np.zeros(ROWS))
    assert_array_equal(kind.distort(orbit, values, record), orbit)
    assert_array_equal(run(kind, layout, PLACES, values, orbit), orbit)


@pytest.mark.parametrize("name", UNDOABLE)
def test_the_jacobian_is_that_of_numerical_derivatives(layout, name):
    kind, values = effect(name), SENSORS[name]
    record = record_of(layout, walk(layout, 8), (0, 5))
    readings, step = record.readings[:, PLACES], 1e-9
    _, told = kind.restore(readings, values, record)
    for row in range(len(record)):
        block = np.empty((3, 3))
        for column in range(3):
            moved = np.zeros_like(readings)
            moved[row, column] = step
            up, _ = kind.restore(readings + moved, values, record)
            down, _ = kind.restore(readings - moved, values, record)
            block[:, column] = (up - down)[row] / (2 * step)
            assert_array_equal(up[:row], down[:row])  # causal: the determinant is that of blocks
        assert np.linalg.slogdet(block)[1] == pytest.approx(told[row], abs=1e-6)


@given(
    st.floats(-1e5, 1e5),
    st.floats(-1e10, 1e10),
    st.lists(st.floats(-5e-3, 5e-3), min_size=1, max_size=20),
)
def test_any_curve_can_be_straightened_everywhere(quadratic, cubic, positions):
    kind, values = effect("bpm-nonlinearity"), {"quadratic": quadratic, "cubic": cubic}
    orbit = np.array(positions)[:, None]
    bent = kind.distort(orbit, values, None)
    restored, jacobian = kind.restore(bent, values, None)
    assert_allclose(restored, orbit, rtol=1e-9, atol=1e-12)
    assert np.all(jacobian <= -np.log(0.2) + 1e-9)


def test_the_curve_is_the_polynomial_where_that_is_steep_enough():
    kind, values = effect("bpm-nonlinearity"), {"quadratic": 300.0, "cubic": 1e5}
    x = np.linspace(-0.8e-3, 1e-3, 50)[:, None]
    assert_allclose(kind.distort(x, values, None), x + 300 * x**2 + 1e5 * x**3, rtol=1e-12)
    beyond = kind.distort(np.array([[2.0], [3.0]]), values | {"cubic": -1e5}, None)
    assert np.diff(beyond, axis=0)[0, 0] == pytest.approx(0.2, rel=1e-9)


def test_a_roll_is_a_rotation_of_the_pair(both_planes):
    kind, values = effect("bpm-roll"), {"angle": 0.1}
    orbit, pairs = walk(both_planes), kind.pairs(both_planes)
    place = 7
    horizontal, vertical = pairs[place]
    assert both_planes.bpms.names[horizontal] == both_planes.bpms.names[vertical]
    assert (both_planes.bpms.planes[horizontal], both_planes.bpms.planes[vertical]) == ("x", "y")
    for places in ([horizontal], [vertical], [horizontal, vertical]):
        readings = run(kind, both_planes, np.array(places), values, orbit)
        expected = orbit.copy()
        expected[:, pairs[place]] = orbit[:, pairs[place]] @ kind.matrix(values).T
        assert_allclose(readings, expected, rtol=0, atol=1e-15)
    # a beam that is moved in x only is read in y with the opposite sign
    assert kind.matrix(values)[1, 0] == pytest.approx(-np.sin(0.1))
    assert np.linalg.det(kind.matrix(values)) == pytest.approx(1.0)
    assert_array_equal(kind.matrix(nominal(kind)), np.eye(2))


def test_a_roll_needs_both_planes(layout):
    kind = effect("bpm-roll")
    assert kind.pairs(layout).shape == (0, 2)
    assert "both planes" in kind.unavailable(record_of(layout, walk(layout)))
    with pytest.raises(ConfigError, match="both planes"):
        kind.simulate(layout, np.array([3]), {"angle": 0.1}, np.random.default_rng(0))


def test_a_swap_exchanges_two_columns(both_planes):
    kind, orbit, n = effect("bpm-swap"), walk(both_planes), len(both_planes.bpms) // 2
    pairs = {tuple(map(int, pair)) for pair in kind.pairs(both_planes)}
    assert len(pairs) == 2 * (n * (n - 1) // 2) + n
    # one plane, both planes, the planes of one BPM
    for places, exchanged in (
        ([5, 90], [(5, 90)]),
        ([5, 90, n + 5, n + 90], [(5, 90), (n + 5, n + 90)]),
        ([5, n + 5], [(5, n + 5)]),
    ):
        assert pairs.issuperset(exchanged)
        expected = orbit.copy()
        for pair in exchanged:
            expected[:, pair] = orbit[:, pair] @ kind.matrix({}).T
        assert_array_equal(run(kind, both_planes, np.array(places), {}, orbit), expected)
        assert_array_equal(expected[:, places[0]], orbit[:, exchanged[0][1]])
    with pytest.raises(ConfigError, match="3 BPMs"):
        kind.simulate(both_planes, np.array([1, 2, 3]), {}, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "values", "columns"),
    [
        ("noise-level", {"factor": 3.0}, [8]),
        ("noise-level", {"factor": 0.5}, [8]),
        ("noise-coloured", {"correlation": -0.6}, [8]),
        ("noise-coloured", {"correlation": 0.8}, [8]),
        ("noise-correlated", {"rms": 0.3e-6}, None),
    ],
)
def test_noise_gains_the_covariance_that_is_told(layout, name, values, columns):
    kind, rms, rows = effect(name), 0.2e-6, 4_000
    place = kind.places_of(layout).index("C07 (x)") if columns is None else columns[0]
    shape = kind.patterns(layout)[:, place]
    places = np.flatnonzero(shape)
    assert columns is None or list(places) == columns
    orbit = walk(layout, rows)
    noise = rms * np.random.default_rng(5).standard_normal(orbit.shape)
    found = run(kind, layout, places, values, orbit, noise) - orbit
    untouched = np.setdiff1d(np.arange(len(layout.bpms)), places)
    assert_allclose(found[:, untouched], noise[:, untouched], rtol=0, atol=1e-12)
    later, earlier = found[kind.lag :, places], found[: rows - kind.lag, places]
    covariance = later.T @ earlier / len(later) / rms**2
    white = np.eye(len(places)) if kind.lag == 0 else 0.0
    told = white + kind.variance(values, rms) / rms**2 * np.outer(shape, shape)[places][:, places]
    # 4 sigma of these samples, sigma at most √2 of the largest variance / √rows
    assert_allclose(covariance, told, atol=4 * 1.5 * max(np.max(np.abs(told)), 1.0) / np.sqrt(rows))
    if name == "noise-coloured":
        assert np.var(found[:, places]) == pytest.approx(rms**2, rel=0.1)


@pytest.mark.parametrize("name", NOISE)
def test_sizes_and_variances_are_inverse(layout, name):
    kind = effect(name)
    first = kind.parameters[0]
    for value in (first.typical, first.nominal, 0.6 * first.typical):
        kappa = kind.variance({first.name: value}, 0.2e-6)
        assert kind.size(kappa, 0.2e-6) == pytest.approx(value, rel=1e-9, abs=1e-15)
    assert kind.variance(nominal(kind), 0.2e-6) == 0.0
    assert first.low <= kind.size(-1.0, 0.2e-6) <= kind.size(1.0, 0.2e-6)
    orbit = walk(layout)
    noise = 0.2e-6 * np.random.default_rng(3).standard_normal(orbit.shape)
    read = run(kind, layout, PLACES, nominal(kind), orbit, noise)
    assert_array_equal(read, orbit + noise)
    assert kind.patterns(layout).shape == (len(layout.bpms), len(kind.places_of(layout)))


def test_a_common_noise_is_common_to_one_plane_only(both_planes):
    kind, n = effect("noise-correlated"), len(both_planes.bpms) // 2
    places = np.array([2, 3, n + 2, n + 3])
    found = run(kind, both_planes, places, {"rms": 1e-6}, np.zeros((2000, 2 * n)))[:, places]
    assert_array_equal(found[:, 0], found[:, 1])
    assert_array_equal(found[:, 2], found[:, 3])
    assert abs(np.corrcoef(found[:, 0], found[:, 2])[0, 1]) < 0.1


def test_without_cells_runs_of_neighbours_are_the_groups(layout):
    bpms = layout.bpms
    bare = replace(layout, bpms=Devices(bpms.names, bpms.planes, ("",) * len(bpms)))
    kind = effect("noise-correlated")
    shapes = kind.patterns(bare)
    sizes = {2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, len(bpms)}
    assert {int(size) for size in shapes.sum(axis=0)} == sizes
    begins = {int(np.argmax(shape)) for shape in shapes.T if shape.sum() == 4}
    assert begins == set(range(len(bpms) - 3))
    assert len(set(kind.places_of(bare))) == shapes.shape[1]
    assert kind.places_of(bare)[-1] == "all (x)"


def test_spikes_come_as_often_and_as_large_as_told(layout):
    kind, orbit = effect("noise-tails"), walk(layout, 20_000)
    values = {"probability": 0.02, "amplitude": 5e-6}
    found = (run(kind, layout, PLACES, values, orbit) - orbit)[:, PLACES]
    spikes = found[np.abs(found) > 1e-12]
    assert len(spikes) / found.size == pytest.approx(0.02, rel=0.12)  # 60,000 draws, 4 sigma
    assert np.std(spikes) == pytest.approx(5e-6, rel=0.1)
    assert_array_equal(kind.shapes(record_of(layout, orbit), orbit, orbit), np.ones_like(orbit))
    still = run(kind, layout, PLACES, nominal(kind), orbit)
    assert_array_equal(still, orbit)


def test_jitter_moves_readings_along_the_slope_of_the_orbit(layout):
    kind = effect("clock-jitter")
    steps = np.random.default_rng(5).standard_normal((3000, len(layout.correctors)))
    currents = np.cumsum(1e-3 * steps, axis=0)
    orbit = currents @ layout.response.T
    record = record_of(layout, orbit)
    change = run(kind, layout, np.zeros(0, dtype=int), {"rms": 0.02}, orbit) - orbit
    slope = kind.shapes(record, currents, orbit)
    delay = np.sum(change[1:] * slope[1:], axis=1) / np.sum(slope[1:] ** 2, axis=1)
    assert_allclose(change[1:], delay[:, None] * slope[1:], rtol=0, atol=1e-12)
    assert np.std(delay) == pytest.approx(0.02, rel=4 / np.sqrt(2 * 3000))
    assert_array_equal(slope[0], np.zeros_like(orbit[0]))
    values = {"rms": 0.02, "mean": -0.016}  # early: the rest of the rms is 0.012
    early = run(kind, layout, np.zeros(0, dtype=int), values, orbit) - orbit
    assert_allclose(early[1:], (0.6 * delay - 0.016)[:, None] * slope[1:], rtol=0, atol=1e-12)
    crate = run(kind, layout, PLACES, {"rms": 0.02}, orbit) - orbit
    assert_array_equal(crate[:, PLACES], change[:, PLACES])  # with a trigger of its own
    assert_array_equal(np.delete(crate, PLACES, axis=1), 0.0)
    noise = 1e-6 * np.random.default_rng(2).standard_normal(orbit.shape)
    noisy = run(kind, layout, np.zeros(0, dtype=int), {"rms": 0.02}, orbit, noise)
    assert_allclose(noisy - noise - orbit, change, rtol=0, atol=1e-12)  # noise has no slope
    assert_array_equal(run(kind, layout, PLACES, nominal(kind), orbit), orbit)


def test_a_missed_read_repeats_the_whole_orbit(layout):
    kind, orbit = effect("missed-read"), walk(layout, 3000)
    readings = run(kind, layout, np.zeros(0, dtype=int), {"probability": 0.05}, orbit)
    repeated = np.flatnonzero(np.all(readings[1:] == readings[:-1], axis=1)) + 1
    assert len(repeated) / 3000 == pytest.approx(0.05, rel=0.32)  # 4 sigma
    others = np.setdiff1d(np.arange(3000), repeated)
    assert_array_equal(readings[others], orbit[others])
    shapes = kind.shapes(record_of(layout, orbit), orbit, orbit)
    first = repeated[~np.isin(repeated - 1, repeated)]  # two in sequence go back further
    assert_allclose(readings[first], orbit[first] + shapes[first], rtol=0, atol=1e-15)
    assert_array_equal(run(kind, layout, PLACES, nominal(kind), orbit), orbit)


def test_records_that_cannot_show_an_effect_say_so(layout):
    record = record_of(layout, walk(layout))
    current = effect("bpm-current")
    assert current.unavailable(record) == ""
    assert current.unavailable(replace(record, auxiliary={})) == ""  # a sawtooth is sought
    constant = replace(record, auxiliary={"current": np.full(ROWS, 0.5)})
    assert "does not change" in current.unavailable(constant)
    gaps = replace(record, auxiliary={"current": np.full(ROWS, np.nan)})
    assert "missing" in current.unavailable(gaps)
    assert "integrity" in effect("bpm-stuck").unavailable(record)


def test_a_simulated_current_takes_the_place_of_the_sawtooth(layout):
    made = effect("bpm-current").simulate(layout, PLACES, {"slope": 1e-3}, np.random.default_rng(0))
    orbit = np.zeros(len(layout.bpms))
    for tick, stored in enumerate((0.4, 0.39, 0.41)):
        made.stored = stored
        read = made.sense(orbit, tick)
        assert_allclose(read[PLACES], 1e-3 * (stored - 0.4), atol=1e-18)


@pytest.mark.parametrize(
    "name", [*SENSORS, *NOISE, "bpm-roll", "noise-tails", "clock-jitter", "missed-read"]
)
def test_grids_stay_within_bounds_and_off_nominal(layout, name):
    kind = effect(name)
    sets = kind.grid(record_of(layout, walk(layout)))
    assert len({tuple(values.items()) for values in sets}) == len(sets) > 0
    for values in sets:
        assert set(values) == {p.name for p in kind.parameters}
        assert all(p.low <= values[p.name] <= p.high for p in kind.parameters)
        assert name == "bpm-polarity" or values != nominal(kind)
