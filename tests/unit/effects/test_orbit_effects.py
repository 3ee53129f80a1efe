"""Effects of optics and disturbances: hooks of records against the plant's and against oracles."""

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from orbitfb.effects.build import layout_of
from orbitfb.effects.kicks import interpolation, kicks_between, source_names, straights
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.effects.optics.tunes import tune_change
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import energy_orbit, green, rf_orbit
from orbitfb.physics.places import plane_row
from orbitfb.physics.response import response
from orbitfb.physics.sextupoles import SextupoleOrbit
from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record

ROWS = 12
SOURCES = ("quadrupole-gradient", "skew-coupling", "sextupole", "local-kick", "thermal-drift")
VALUES = {
    "quadrupole-gradient": {"gradient": 0.02},
    "optics-drift": {"rate": 0.02},
    "skew-coupling": {"skew": 0.02},
    "local-kick": {"kick": 1e-6},
    "thermal-drift": {"rate": 1e-6, "tau": 30.0},
    "periodic-disturbance": {"cosine": 1e-6, "sine": -2e-6, "frequency": 1.3},
    "insertion-device": {"kick": 1e-6, "period": 0.03, "duration": 0.6},
    "tune-shift": {"dnu_x": 0.01, "dnu_y": -0.02},
    "tune-drift": {"rate_x": 3e-3, "rate_y": -2e-3},
    "energy-offset": {"offset": 1e-4},
    "energy-ramp": {"rate": 1e-4},
}
ALL = (*VALUES, "sextupole", "energy-drift", "ground-motion-level", "telegraph")


def nominal(kind):
    return {p.name: p.nominal for p in kind.parameters}


def currents_of(layout, rows=ROWS, rms=0.5, seed=3):
    return rms * np.random.default_rng(seed).standard_normal((rows, len(layout.correctors)))


def record_of(layout, setpoints, orbit, auxiliary=None):
    rows = len(setpoints)
    return Record(
        layout=layout,
        time=np.arange(rows) * layout.period,
        starts=np.arange(rows) == 0,
        readings=orbit,
        setpoints=setpoints,
        requested=np.zeros_like(setpoints),
        readback=None,
        dither=None,
        reference=None,
        filled=np.zeros(orbit.shape, dtype=bool),
        auxiliary=auxiliary or {},
        source="test",
        digest="",
    )


def simulated(kind, layout, places, values, setpoints, disturbance=None, seed=0):
    """Orbit of every tick with the effect in it, and without."""
    where, rng = np.array(places, dtype=np.intp), np.random.default_rng(seed)
    its = kind.simulate(layout, where, values, rng)
    without = setpoints @ layout.response.T
    orbits = []
    for tick, currents in enumerate(setpoints):
        acting = its.actuate(currents, tick)
        orbit = its.respond(without[tick], acting, tick)
        if disturbance is not None:
            orbit = orbit + disturbance[tick]
        orbits.append(its.sense(its.disturb(orbit, tick), tick))
    return np.array(orbits), without if disturbance is None else without + disturbance


def some(devices, columns):
    fields = (devices.names, devices.planes, devices.cells)
    return Devices(*(tuple(field[i] for i in columns) for field in fields))


def told(kind, layout, places, values, setpoints, orbit, auxiliary=None):
    record = record_of(layout, setpoints, orbit, auxiliary)
    if isinstance(kind, RingKind):
        return kind.deflect(values, record, setpoints, orbit)
    weights = np.zeros(len(kind.places_of(layout)))
    weights[places] = kind.shares(layout, np.array(places, dtype=np.intp))
    signals = Signals(record, setpoints, orbit)
    (law,) = (one for one in kind.laws(signals) if isinstance(one, DeviceLaw))
    return sum(
        (course * weights) @ block.T
        for block, course in zip(law.patterns, law.course(values, signals), strict=True)
    )


def near(actual, wanted, share):
    size = np.abs(wanted).max()
    assert size > 0
    assert_allclose(actual, wanted, rtol=0, atol=share * size)


@pytest.mark.parametrize("name", list(VALUES))
@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_hooks_of_the_record_tell_what_the_plant_does(ring, name, planes):
    layout = layout_of(ring, planes, 0.1)
    kind, values = effect(name), VALUES[name]
    setpoints = currents_of(layout)
    orbit = setpoints @ layout.response.T
    if kind.unavailable(record_of(layout, setpoints, orbit)):
        assert (name, planes) in {
            ("skew-coupling", "x"),
            ("skew-coupling", "y"),
            ("energy-offset", "y"),
            ("energy-ramp", "y"),
        }
        return
    places = [7] if isinstance(kind, SourceKind) else []
    after, before = simulated(kind, layout, places, values, setpoints)
    near(told(kind, layout, places, values, setpoints, orbit), after - before, 1e-9)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("planes", ["x", "xy"])
def test_nominal_values_change_nothing(ring, name, planes):
    layout = layout_of(ring, planes, 0.1)
    kind = effect(name)
    setpoints = currents_of(layout)
    orbit = setpoints @ layout.response.T
    if kind.unavailable(record_of(layout, setpoints, orbit)):
        return
    places = [] if kind.target == "ring" else [3, 40]
    after, before = simulated(kind, layout, places, nominal(kind), setpoints)
    assert_array_equal(after, before)
    if isinstance(kind, SourceKind | RingKind):
        assert not np.any(told(kind, layout, places, nominal(kind), setpoints, orbit))


@pytest.mark.parametrize("name", ALL)
def test_patterns_drivers_and_names_fit_together(both_planes, name):
    kind = effect(name)
    if isinstance(kind, RingKind):
        return
    names = kind.places_of(both_planes)
    assert len(set(names)) == len(names)
    patterns = kind.patterns(both_planes)
    assert patterns.shape == (len(both_planes.bpms), len(names))
    assert np.all(np.any(patterns, axis=0))
    if isinstance(kind, SourceKind):
        setpoints = currents_of(both_planes)
        orbit = setpoints @ both_planes.response.T
        record = record_of(both_planes, setpoints, orbit)
        courses = kind.drivers(kind.grid(record)[0], record, setpoints, orbit)
        assert courses.shape in (
            (ROWS, 1),
            (ROWS, len(names)),
            (2, ROWS, len(names)),
        )


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_a_gradient_error_is_exact_in_both_planes(ring, planes):
    layout = layout_of(ring, planes, 0.1)
    kind, setpoints = effect("quadrupole-gradient"), np.eye(len(layout.correctors))
    errors = np.zeros(300)
    errors[[20, 21]] = 0.02
    # each alone
    for place in (20, 21):
        alone = np.where(np.arange(300) == place, errors, 0.0)
        wanted = (response(ring, planes, alone) - layout.response).T
        change = told(
            kind, layout, [place], {"gradient": 0.02}, setpoints, setpoints @ layout.response.T
        )
        near(change, wanted, 1e-9)
    # both, with all that goes between them
    its = kind.simulate(layout, np.array([20, 21]), {"gradient": 0.02}, np.random.default_rng(0))
    near(its.respond(layout.response, setpoints, 5), response(ring, planes, errors), 1e-9)


def test_gradients_that_drift_are_those_of_the_green_function(ring, both_planes):
    kind = effect("optics-drift")
    its = kind.simulate(both_planes, np.arange(300), {"rate": 1e-3}, np.random.default_rng(5))
    rates = 1e-3 * np.random.default_rng(5).standard_normal(300)
    setpoints = np.eye(len(both_planes.correctors))
    assert_array_equal(its.respond(both_planes.response, setpoints, 0), both_planes.response)
    for tick in (40, 90):
        wanted = response(ring, "xy", rates * ring.strength("QUAD") * 0.1 * tick)
        found = its.respond(both_planes.response, setpoints, tick)
        near(found - both_planes.response, wanted - both_planes.response, 1e-8)


def test_a_rectangular_layout_of_some_devices(ring, both_planes):
    bpms, correctors = [3, 9, 200, 201, 300], [5, 100, 190, 330]
    small = Layout(
        some(both_planes.bpms, bpms),
        some(both_planes.correctors, correctors),
        both_planes.response[np.ix_(bpms, correctors)],
        0.1,
        ring,
    )
    for name in ("quadrupole-gradient", "tune-shift", "skew-coupling", "sextupole"):
        kind = effect(name)
        values = VALUES.get(name, {"strength": 30.0})
        wide = np.zeros((3, len(both_planes.correctors)))
        wide[:, correctors] = currents_of(small, 3, rms=0.02)
        places = [33] if kind.target != "ring" else []
        whole, _ = simulated(kind, both_planes, places, values, wide)
        part, before = simulated(kind, small, places, values, wide[:, correctors])
        near(part, whole[:, bpms], 1e-9)
        change = told(kind, small, places, values, wide[:, correctors], before)
        # from few BPMs nobody knows the sextupole's own kick in itself
        near(change, part - before, 3e-2 if name == "sextupole" else 1e-9)


def test_shifted_tunes_are_nearly_those_of_scaled_phases(ring):
    for plane, least in (("x", 0.999), ("y", 0.99)):
        layout = layout_of(ring, plane, 0.1)
        row, shift = ("x", "y").index(plane), 0.004
        phase = ring.table.phase.copy()
        tune = ring.tune(plane)
        phase[row] *= (tune + shift) / tune
        moved = replace(
            ring,
            table=replace(ring.table, phase=phase),
            parameters=ring.parameters.model_copy(update={f"nu_{plane}": tune + shift}),
        )
        wanted = response(moved, plane) - layout.response
        both = (shift, 0.0) if plane == "x" else (0.0, shift)
        change = tune_change(layout, *both)
        alike = np.sum(change * wanted) / np.linalg.norm(change) / np.linalg.norm(wanted)
        assert alike > least
        assert np.linalg.norm(change) == pytest.approx(np.linalg.norm(wanted), rel=0.2)


@pytest.mark.parametrize("planes", ["x", "xy"])
def test_sextupoles_bend_the_orbit_as_the_fixed_point_does(ring, planes):
    layout = layout_of(ring, planes, 0.1)
    kind, strength, place = effect("sextupole"), 20.0, 61
    setpoints = currents_of(layout, 4, rms=0.01)
    strengths = ring.table.strength.copy()
    index = ring.places("SEXT")
    strengths[index] = 0.0
    strengths[index[place]] = strength
    oracle = SextupoleOrbit(replace(ring, table=replace(ring.table, strength=strengths)))
    orbits = []
    for row in setpoints:
        kicks_x = row[:180] * ring.calibration("x")
        kicks_y = row[180:] * ring.calibration("y") if planes == "xy" else np.zeros(180)
        pair = oracle.solve(kicks_x, kicks_y)
        orbits.append(np.concatenate([pair.x, pair.y]) if planes == "xy" else pair.x)
    wanted = np.array(orbits) - setpoints @ layout.response.T
    after, before = simulated(kind, layout, [place], {"strength": strength}, setpoints)
    near(after - before, wanted, 1e-6)
    change = told(kind, layout, [place], {"strength": strength}, setpoints, np.array(orbits))
    near(change, wanted, 1e-2)  # the orbit in the sextupole, from the BPMs


@pytest.mark.parametrize("family", ["all", "family of SM2_C30"])
def test_sextupoles_that_act_together_have_the_ratios_of_the_table(ring, layout, family):
    kind = effect("sextupole")
    places = kind.families(layout)[family]
    chosen = ring.places("SEXT")[places]
    strengths = np.zeros_like(ring.table.strength)
    strengths[chosen] = ring.table.strength[chosen]
    oracle = SextupoleOrbit(replace(ring, table=replace(ring.table, strength=strengths)))
    setpoints = currents_of(layout, 4, rms=0.005)
    kicks = setpoints * ring.calibration("x")
    orbits = np.array([oracle.solve(row, np.zeros(180)).x for row in kicks])
    wanted = orbits - setpoints @ layout.response.T
    values = {"strength": float(np.mean(np.abs(ring.table.strength[chosen])))}
    after, before = simulated(kind, layout, places, values, setpoints)
    near(after - before, wanted, 1e-6)
    near(told(kind, layout, places, values, setpoints, orbits), wanted, 3e-2)


def test_an_orbit_of_disturbances_feeds_down(ring, layout):
    kind, place, strength = effect("sextupole"), 61, 20.0
    rng = np.random.default_rng(8)
    moved = rng.standard_normal(300) * 3e-7 * ring.strength("QUAD")
    besides = green(ring, "BPM", "QUAD", "x") @ moved
    here = ring.places("SEXT")[[place]]
    at = (green(ring, here, "QUAD", "x") @ moved)[0]
    setpoints = currents_of(layout, 3, rms=0.001)
    reach = setpoints @ layout.orbit_at(here, "x")[0] + at
    disturbance = np.tile(besides, (3, 1))
    pattern = layout.orbit_per_kick(here, "x")[:, 0]
    own, inside = green(ring, here, here, "x")[0, 0], reach
    for _ in range(50):
        inside = reach - own * strength * inside**2
    wanted = -strength * np.outer(inside**2, pattern)
    after, before = simulated(kind, layout, [place], {"strength": strength}, setpoints, disturbance)
    near(after - before, wanted, 3e-3)  # the orbit between the BPMs is not known exactly
    near(told(kind, layout, [place], {"strength": strength}, setpoints, after), wanted, 3e-3)


@pytest.mark.parametrize("kind", ["SEXT", "QUAD"])
def test_orbits_between_bpms_follow_from_those_at_bpms(ring, both_planes, kind):
    rng = np.random.default_rng(1)
    for plane in ("x", "y"):
        moved = rng.standard_normal(300) * ring.strength("QUAD")
        orbit = both_planes.orbit_per_kick("QUAD", plane) @ moved
        wanted = green(ring, kind, "QUAD", plane) @ moved
        found = interpolation(both_planes, kind, plane) @ orbit
        assert np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2)) < 0.01


def test_a_skew_quadrupole_against_the_iterated_orbit(ring, both_planes):
    kind, skew, place = effect("skew-coupling"), 0.02, 100
    setpoints = currents_of(both_planes, 3)
    quad = ring.places("QUAD")[[place]]
    start = {p: setpoints @ both_planes.orbit_at(quad, p)[0] for p in ("x", "y")}
    own = {p: green(ring, quad, quad, p)[0, 0] for p in ("x", "y")}
    x, y = start["x"], start["y"]
    for _ in range(100):
        x, y = start["x"] + own["x"] * skew * y, start["y"] + own["y"] * skew * x
    wanted = np.outer(skew * y, both_planes.orbit_per_kick(quad, "x")[:, 0])
    wanted += np.outer(skew * x, both_planes.orbit_per_kick(quad, "y")[:, 0])
    after, before = simulated(kind, both_planes, [place], {"skew": skew}, setpoints)
    near(after - before, wanted, 1e-9)


def test_energy_follows_the_dispersion_and_the_rf(ring, both_planes):
    setpoints = currents_of(both_planes, 5)
    zero = np.zeros(180)
    kind = effect("energy-offset")
    frequency = 10.0
    deviation = -frequency / (ring.rf_frequency * ring.parameters.alpha_c)
    after, before = simulated(kind, both_planes, [], {"offset": deviation}, setpoints)
    wanted = np.concatenate([rf_orbit(ring, "BPM", frequency), zero])
    near(after - before, np.tile(wanted, (5, 1)), 1e-9)
    after, before = simulated(effect("energy-ramp"), both_planes, [], {"rate": 1e-4}, setpoints)
    wanted = np.concatenate([energy_orbit(ring, "BPM", 4e-5), zero])
    near((after - before)[4], wanted, 1e-9)


def test_kicks_are_closed_orbits_of_their_place(ring, both_planes):
    kind = effect("local-kick")
    names = kind.places_of(both_planes)
    for label, where, plane in (("QH1A_C30 (y)", "QUAD", "y"), ("CH1A_C30 (x)", "COR", "x")):
        place = names.index(label)
        index = ring.places(where)[[ring.names(where).index(label.split()[0])]]
        pattern = kind.patterns(both_planes)[:, place]
        blocks = [green(ring, "BPM", index, p)[:, 0] * (p == plane) for p in ("x", "y")]
        assert_allclose(pattern, np.concatenate(blocks), rtol=1e-12, atol=0)


def test_a_kick_that_grows_steadily_needs_no_time_constant(layout):
    """One far beyond the record makes the same; only a kick that settles pays for it."""
    kind = effect("thermal-drift")
    record = record_of(layout, currents_of(layout), np.zeros((ROWS, len(layout.bpms))))
    *settling, steady = kind.grid(record)
    plain = {"rate": steady["rate"]}
    courses = [
        kind.drivers(one, record, record.setpoints, record.readings) for one in (steady, plain)
    ]
    np.testing.assert_allclose(courses[0], courses[1])
    np.testing.assert_allclose(courses[1][:, 0], plain["rate"] * record.time, rtol=1e-4)
    named = [[one.name for one in kind.set_by(values, record)] for values in kind.grid(record)]
    assert named == [["rate", "tau"]] * len(settling) + [["rate"]]


def test_a_recorded_gap_drives_the_kick(layout):
    kind = effect("insertion-device")
    setpoints = currents_of(layout, 4)
    gap = np.array([25e-3, 20e-3, 15e-3, 5e-3])
    still = np.full(4, 7e-3)
    change = told(
        kind,
        layout,
        [2],
        {"kick": 1e-6, "period": 0.04, "duration": 1.0},
        setpoints,
        np.zeros((4, 180)),
        {"other": gap * 9, "ID03 Gap": gap, "ID05 gap": still},
    )
    # By ratios of the field: each 5 mm of a period of 40 mm are a factor exp(π/8).
    step = np.exp(np.pi / 8)
    share = (step ** np.array([0, 1, 2, 4]) - 1) * step**-3
    assert_allclose(change, np.outer(share * 1e-6, kind.patterns(layout)[:, 2]), atol=1e-15)


def test_a_device_with_a_second_field_integral_displaces_the_beam(ring, both_planes):
    """Against the closed orbit of a beam that a straight displaces by its length per kick.

    That is −L ∂G/∂s of the source: Twiss α at its first end follows from the drift, in which the
    beam goes straight on: √(β₂/β₁) (cos Δφ + α₁ sin Δφ) = 1 and L = √(β₁ β₂) sin Δφ.
    """
    kind = effect("insertion-device")
    names, patterns = kind.places_of(both_planes), kind.patterns(both_planes)
    assert len(names) == patterns.shape[1] == len(set(names))
    label = next(name for name in names if " against " in name and name.endswith("(y)"))
    ends = [ring.table.name.index(name) for name in label[:-4].split(" against ")]
    row, half_turn = plane_row("y"), np.pi * ring.tune("y")
    beta, phase = ring.table.beta[row], ring.table.phase[row]
    (first, second), ahead = beta[ends], phase[ends[1]] - phase[ends[0]]
    alpha = (np.sqrt(first / second) - np.cos(ahead)) / np.sin(ahead)
    length = np.sqrt(first * second) * np.sin(ahead)
    bpms = ring.places("BPM", "y")
    since = phase[bpms] - phase[ends[0]]
    beyond = (since < 0.0) | (since > ahead)
    turned = np.abs(since) - half_turn
    bent = alpha * np.cos(turned) - np.sign(since) * np.sin(turned)
    orbit = length * np.sqrt(beta[bpms] / first) * bent / (2.0 * np.sin(half_turn))
    told = patterns[both_planes.bpms.in_plane("y"), names.index(label)]
    assert_allclose(told[beyond], orbit[beyond], atol=1e-9 * np.abs(orbit).max())
    apart = ring.table.s[ends[1]] - ring.table.s[ends[0]]
    assert_allclose(length, apart, rtol=0.05)


def test_every_gap_that_moves_is_tried(layout):
    kind = effect("insertion-device")
    gaps = {f"ID0{k} gap": np.linspace(25e-3, 25e-3 - 5e-3 * k, 4) for k in (2, 0, 1)}
    setpoints = currents_of(layout, 4)
    its = record_of(layout, setpoints, np.zeros((4, 180)), gaps)
    assert {values["gap"] for values in kind.grid(its)} == {1, 2}  # in the order of their names
    values = {"kick": 1e-6, "period": 0.04, "duration": 1.0, "gap": 2}
    changes = [
        kind.drivers({**values, "gap": k}, its, setpoints, np.zeros((4, 180))) for k in (1, 2)
    ]
    assert np.ptp(changes[1]) > np.ptp(changes[0]) > 0.0
    (choice,) = (p for p in kind.parameters if p.name == "gap")
    assert kind.meaning(choice, 2, its) == "ID02 gap"
    assert kind.meaning(choice, 0, replace(its, auxiliary={"gap": gaps["ID01 gap"]})) == ""


def test_a_gap_that_stands_still_kicks_nobody(layout):
    kind = effect("insertion-device")
    channels = {"gap": np.full(4, 7e-3)}
    values = {"kick": 1e-6, "period": 0.04, "duration": 1.0}
    setpoints = currents_of(layout, 4)
    change = told(kind, layout, [2], values, setpoints, np.zeros((4, 180)), channels)
    assert_array_equal(change, 0.0)


def test_walks_have_the_variance_that_they_tell(layout):
    rows = 4000
    setpoints = np.zeros((rows, 180))
    energy = effect("energy-drift")
    values = {"step": 2e-7}
    after, _ = simulated(energy, layout, [], values, setpoints)
    steps = np.diff(after @ energy.patterns(layout)[:, 0]) / np.sum(energy.patterns(layout) ** 2)
    assert np.var(steps) == pytest.approx(energy.variance(values, 1e-7), rel=0.1)
    telegraph = effect("telegraph")
    values = {"kick": 3e-7, "probability": 0.1}
    after, _ = simulated(telegraph, layout, [40], values, setpoints)
    pattern = telegraph.patterns(layout)[:, 40]
    height = after @ pattern / np.sum(pattern**2)
    assert set(np.round(height / 3e-7, 9)) == {-1.0, 1.0}
    assert np.var(np.diff(height)) == pytest.approx(telegraph.variance(values, 1e-7), rel=0.15)
    for kind in (energy, telegraph):
        typical = {p.name: p.typical for p in kind.parameters}
        size = kind.size(kind.variance(typical, 1e-7), 1e-7)
        assert size == pytest.approx(typical[kind.parameters[0].name])
        assert kind.size(-1e-14, 1e-7) < 0


def test_more_ground_motion_enlarges_the_steps(layout):
    kind = effect("ground-motion-level")
    setpoints = currents_of(layout, 50)
    walk = 1e-4 + np.cumsum(np.random.default_rng(2).standard_normal((50, 180)), axis=0) * 1e-6
    after, _ = simulated(kind, layout, [], {"factor": 2.5}, setpoints, walk)
    moved = after - setpoints @ layout.response.T
    assert_allclose(moved[0], walk[0], atol=1e-12)
    assert_allclose(np.diff(moved, axis=0), 2.5 * np.diff(walk, axis=0), atol=1e-12)
    assert kind.size(kind.variance({"factor": 2.5}, 3e-9), 3e-9) == pytest.approx(2.5)
    assert isinstance(kind, NoiseKind) and kind.colour == "walk"


def test_a_stretch_of_fixed_size_is_scanned_quickly(both_planes):
    rows = 1500
    setpoints = currents_of(both_planes, rows)
    orbit = setpoints @ both_planes.response.T
    record = record_of(both_planes, setpoints, orbit)
    for name in SOURCES:
        kind = effect(name)
        begin = time.process_time()
        kind.drivers({p.name: p.typical for p in kind.parameters}, record, setpoints, orbit)
        assert time.process_time() - begin < 3.0


KICKING = {"local-kick", "thermal-drift", "periodic-disturbance", "insertion-device", "telegraph"}
ANYWHERE = {*KICKING, "ground-motion-level", "quadrupole-gradient"}


def unknown_record(layout):
    unknown = replace(layout, ring=None)
    setpoints = currents_of(layout)
    return record_of(unknown, setpoints, setpoints @ layout.response.T)


@pytest.mark.parametrize("name", sorted(set(ALL) - ANYWHERE))
def test_without_a_ring_the_optics_cannot_be_tested(layout, name):
    assert "places table" in effect(name).unavailable(unknown_record(layout))


@pytest.mark.parametrize("name", sorted(ANYWHERE))
def test_without_a_ring_sources_are_looked_for_at_the_correctors(layout, name):
    record, kind = unknown_record(layout), effect(name)
    patterns = kind.patterns(record.layout)
    names = kind.places_of(record.layout)
    assert "places table" not in kind.unavailable(record)
    assert len(names) == patterns.shape[1] == len(layout.correctors)
    assert names[3].startswith(layout.correctors.names[3])
    cosine = patterns[:, 3] @ layout.response[:, 3]
    cosine /= np.linalg.norm(patterns[:, 3]) * np.linalg.norm(layout.response[:, 3])
    assert cosine == pytest.approx(1.0)
    if name in KICKING:  # told as if a corrector kicked 50 µrad/A
        assert_allclose(5e-5 * patterns[:, 3], layout.response[:, 3])


def test_a_kick_within_a_straight_is_that_of_the_corrector_that_stands_there(ring, layout):
    """The table knows the optics at correctors: two of them stand in straights, with BPMs."""
    place, table = ring.table.s[ring.places("QUAD")], ring.table
    per_kick = layout.orbit_per_kick("COR", "x")
    checked = 0
    for first, last in straights(layout):
        length = (place[last] - place[first]) % ring.parameters.circumference
        for column, row in enumerate(ring.places("COR")):
            since = (table.s[row] - place[first]) % ring.parameters.circumference
            if 0.0 < since < length:
                found = kicks_between(layout, [(first, last)], since / length, "x")[:, 0]
                wanted = per_kick[:, column]
                # Quadrupoles of the table are long, not thin: an end is half of one off.
                assert np.linalg.norm(found - wanted) < 0.03 * np.linalg.norm(wanted)
                checked += 1
    assert checked == 90


def test_sources_are_also_the_straights_between_two_quadrupoles(ring, layout):
    names = source_names(layout)
    assert len(names) == 300 + 180 + 90
    assert "QL1B_C30 to QL1A_C01 (x)" in names
    kind = effect("local-kick")
    assert kind.patterns(layout).shape[1] == len(names)
