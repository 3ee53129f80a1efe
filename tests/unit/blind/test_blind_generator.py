"""The generator of sealed cases: physics against closed forms, and that nothing gives it away."""

import hashlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.figures import wilson
from benchmarks.blind.generator.cases import MAKERS, Spec, choose, make
from benchmarks.blind.generator.conditions import Conditions, second_ring
from benchmarks.blind.generator.draft import invented, known
from benchmarks.blind.generator.drawing import GROUND, draw, wander
from benchmarks.blind.generator.generate import opaque, seal, write_case
from benchmarks.blind.generator.healthy import HealthyGradients
from benchmarks.blind.generator.machine import Nature, run
from benchmarks.blind.generator.nature_actuator import Lag, Resonance, Slew
from benchmarks.blind.generator.nature_limits import BoucWen
from benchmarks.blind.generator.nature_link import Missed
from benchmarks.blind.generator.nature_optics import Gradients, Sextupole, growing
from benchmarks.blind.generator.oracle import Innovations
from benchmarks.blind.generator.rings import Lattice, beating_errors
from benchmarks.blind.generator.suites import plan
from orbitfb.physics.optics import green_with_gradient_errors
from orbitfb.physics.places import Ring

ASKED = {
    "bpm-gain",
    "bpm-roll",
    "bpm-offset",
    "bpm-drift",
    "bpm-nonlinearity",
    "bpm-lowpass",
    "bpm-latency",
    "bpm-stuck",
    "bpm-swap",
    "bpm-polarity",
    "bpm-current",
    "noise-level",
    "noise-correlated",
    "noise-coloured",
    "noise-tails",
    "corrector-gain",
    "corrector-polarity",
    "corrector-swap",
    "corrector-stuck",
    "corrector-slew",
    "corrector-lag",
    "corrector-resonance",
    "corrector-quantisation",
    "corrector-deadband",
    "corrector-saturation",
    "corrector-hysteresis",
    "corrector-crosstalk",
    "corrector-roll",
    "loop-delay",
    "missed-write",
    "quadrupole-gradient",
    "tune-shift",
    "optics-drift",
    "sextupole",
    "energy-ramp",
    "energy-offset",
    "skew-coupling",
    "periodic-disturbance",
    "ground-motion-level",
    "thermal-drift",
    "local-kick",
    "insertion-device",
    "telegraph",
    "clock-jitter",
    "missed-read",
}


@pytest.fixture(scope="module")
def ring() -> Ring:
    return Ring.load()


@pytest.fixture(scope="module")
def case(ring: Ring) -> Conditions:
    return draw(np.random.default_rng(3), ring, "first", "x", 150, "white")


def small(effects: tuple[str, ...] = (), seed: int = 5, **wish) -> Spec:
    filled = {"planes": "x", "ring": "first", "dither": "passive", "ticks": 200, "later": 0}
    return Spec(effects=effects, target=12.0, seed=seed, **{**filled, **wish})


def step_answer(effect: Nature, case: Conditions, rows: int) -> np.ndarray:
    """Current of corrector 0 after its setpoint goes from 0 to 1 mA."""
    effect.bind(case, np.random.default_rng(0))
    wanted = np.zeros(len(case.corr_names))
    effect.currents(0, wanted)
    wanted = wanted.copy()
    wanted[0] = 1e-3
    return np.array([effect.currents(row, wanted)[0] for row in range(1, rows + 1)])


@pytest.mark.parametrize(
    ("ground", "least", "most"), [("quadrupoles", -0.05, 0.05), ("going on", 0.15, 0.55)]
)
def test_steps_of_the_ground_go_on_where_it_says_so(
    case: Conditions, ground: str, least: float, most: float
) -> None:
    kicks, _ = wander(replace(case, ground=ground), "x", 1e-4, np.random.default_rng(4))
    steps = np.diff(kicks, axis=0)[1:]
    assert least < np.sum(steps[1:] * steps[:-1]) / np.sum(steps**2) < most


def test_it_imports_nothing_of_the_library_of_effects() -> None:
    code = (
        "import sys, benchmarks.blind.generator.generate, benchmarks.blind.generator.suites\n"
        "allowed = ('orbitfb.physics', 'orbitfb.core')\n"
        "ours = [m for m in sys.modules if m.startswith('orbitfb.')]\n"
        "bad = [m for m in ours if not m.startswith(allowed)]\n"
        "print(*bad, *(m for m in ours if 'effect' in m or 'plant' in m))\n"
    )
    root = Path(__file__).parents[2]
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == []


def test_every_known_effect_has_a_case_and_ten_more_are_in_no_library() -> None:
    assert set(known()) >= ASKED
    assert len(invented()) >= 10
    assert not set(invented()) & ASKED
    assert not any(spec.effects for spec in plan("healthy", 1))
    quick = [spec.effects for spec in plan("quick", 1)]
    assert {name for effects in quick for name in effects} == set(known())
    assert quick.count(()) == 4


def test_a_lag_follows_its_exponential(case: Conditions) -> None:
    tau = 2.5 * case.period
    answer = step_answer(Lag(np.array([0]), tau), case, 12)
    time = (np.arange(1, 13) - case.delay) * case.period
    np.testing.assert_allclose(answer, 1e-3 * (1 - np.exp(-time / tau)), rtol=1e-12)


def test_a_resonance_rings_as_its_closed_form(case: Conditions) -> None:
    turns, damping = 0.12, 0.3
    answer = step_answer(Resonance(np.array([0]), turns, damping), case, 25)
    omega = 2 * np.pi * turns
    damped = omega * np.sqrt(1 - damping**2)
    # The integrator's step of 1/40 tick decides when the setpoint is seen.
    begin = np.ceil(case.delay * 40 - 0.5) / 40
    time = np.arange(1, 26) - begin
    wave = np.cos(damped * time) + damping / np.sqrt(1 - damping**2) * np.sin(damped * time)
    np.testing.assert_allclose(
        answer, 1e-3 * (1 - np.exp(-damping * omega * time) * wave), atol=1e-5
    )


def test_a_slow_supply_goes_at_its_rate(case: Conditions) -> None:
    rate = 1e-4 / case.period
    answer = step_answer(Slew(np.array([0]), rate), case, 14)
    ramp = rate * (np.arange(1, 15) - case.delay) * case.period
    np.testing.assert_allclose(answer, np.minimum(ramp, 1e-3), rtol=1e-12)


def test_hysteresis_encloses_an_area_and_keeps_within_its_width(case: Conditions) -> None:
    width, column = 2e-4, np.array([0])
    effect = BoucWen(column, width, 1.0)
    effect.bind(case, np.random.default_rng(0))
    course = 1e-3 * np.sin(2 * np.pi * np.arange(400) / 100)
    answer = np.array([effect.drive(row, course[row : row + 1])[0] for row in range(400)])
    lag = course - answer
    assert np.max(np.abs(lag)) == pytest.approx(width, rel=0.1)
    loop = np.trapezoid(lag[300:], course[300:])
    assert abs(loop) > 2 * width * 1e-3
    assert abs(np.trapezoid(lag[200:300], course[200:300])) == pytest.approx(abs(loop), rel=1e-3)


def test_wrong_quadrupoles_by_the_full_greens_function(ring: Ring) -> None:
    errors = beating_errors(ring, 0.02, np.random.default_rng(0))
    lattice = Lattice(ring, errors)
    for plane in ("x", "y"):
        own = lattice.response(ring.places("BPM"), ring.places("COR"), plane)
        other = green_with_gradient_errors(ring, "BPM", "COR", plane, errors)
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-12)


def test_a_single_wrong_quadrupole_also_kicks_by_the_standing_orbit(case: Conditions) -> None:
    extra = np.zeros_like(case.lattice.errors)
    extra[17] = 2e-3
    before, after = run(case, [], 9), run(case, [(0, Gradients([(0, extra)]))], 9)
    replay = run(case, [], 9, replay=after.sent)
    seen = (after.readings - replay.readings)[5] / (1 + case.bpm_gains)
    place = case.lattice.quads[[17]]
    at = case.orbit_at(place, "x")[0] @ (after.setpoints[5] * (1 + case.corrector_gains))
    at += case.moved(place, "x")[case.warm + 5, 0]
    own = case.lattice.response(place, place, "x")[0, 0]
    closed = -2e-3 / (1 + 2e-3 * own) * at
    np.testing.assert_allclose(seen, case.kick_orbit(place, "x")[:, 0] * closed, rtol=1e-6)
    assert np.any(before.readings != after.readings)


@pytest.mark.nightly
def test_a_gradient_that_grows_does_so_from_row_to_row(case: Conditions) -> None:
    place, size = case.lattice.quads[[17]], 2e-3
    extra = np.zeros_like(case.lattice.errors)
    extra[17] = size
    after = run(case, [(0, growing(case, extra))], 9)
    seen = after.readings - run(case, [], 9, replay=after.sent).readings
    pattern = case.kick_orbit(place, "x")[:, 0] * (1 + case.bpm_gains)
    kicks = seen @ pattern / (pattern @ pattern)
    at = after.setpoints * (1 + case.corrector_gains) @ case.orbit_at(place, "x")[0]
    at += case.moved(place, "x")[case.warm : case.warm + len(at), 0]
    grown = size * np.arange(case.warm, case.warm + len(at)) / case.rows
    own = case.lattice.response(place, place, "x")[0, 0]
    # The orbit is solved at 25 rows, with straight lines between.
    np.testing.assert_allclose(kicks, -grown / (1 + grown * own) * at, rtol=1e-4)


def test_a_sextupole_kicks_by_the_square_of_its_own_closed_orbit(case: Conditions) -> None:
    place = case.lattice.ring.places("SEXT")[[4]]
    effect = Sextupole(place, 50.0)
    effect.bind(case, np.random.default_rng(0))
    currents = np.full(len(case.corr_names), 1e-3)
    moved = effect.bend(3, np.zeros(len(case.bpm_names)), currents)
    start = case.orbit_at(place, "x")[0] @ currents + case.moved(place, "x")[3, 0]
    own = case.lattice.response(place, place, "x")[0, 0]
    # x = start − own · b x², solved as a quadratic
    orbit = (np.sqrt(1 + 4 * 50.0 * own * start) - 1) / (2 * 50.0 * own)
    np.testing.assert_allclose(
        moved, -50.0 * orbit**2 * case.kick_orbit(place, "x")[:, 0], rtol=1e-6
    )


def test_the_second_ring_is_a_ring(tmp_path: Path) -> None:
    other = second_ring(tmp_path, 1)
    bpms, correctors = other.places("BPM"), other.places("COR")
    assert len(bpms) != len(correctors)
    lattice = Lattice(other, np.zeros(len(other.places("QUAD"))))
    quads = other.places("QUAD")
    for plane, sign in (("x", 1.0), ("y", -1.0)):
        # Between its kick and the next quadrupole an orbit is a straight line whose slope the
        # quadrupole changes by its strength: the thin-lens equations, without any beta function.
        kick = lattice.response(quads[:3], correctors[-1:], plane)[:, 0]
        eta, s = other.table.dispersion[quads[:3]], other.table.s[quads[:3]]
        if plane == "x":  # free of the change of energy
            stretch = other.parameters.alpha_c * other.parameters.circumference
            kick = kick + eta * other.table.dispersion[correctors[-1]] / stretch
        slopes = np.diff(kick) / np.diff(s)
        strength = other.strength("QUAD")[1] * sign
        assert slopes[1] - slopes[0] == pytest.approx(-strength * kick[1], rel=1e-3)


def test_an_effect_that_is_not_there_changes_nothing(case: Conditions) -> None:
    np.testing.assert_array_equal(run(case, [(0, Nature())], 4).readings, run(case, [], 4).readings)


def test_an_effect_has_the_same_luck_alone_as_in_its_pair(case: Conditions) -> None:
    pair, alone, first = Missed(0.1), Missed(0.1), Missed(0.1)
    run(case, [(0, Nature()), (0, pair)], 4)
    run(case, [(0, alone)], 4, number=1)
    run(case, [(0, first)], 4)
    np.testing.assert_array_equal(alone.luck, pair.luck)
    assert np.any(first.luck != pair.luck)


@pytest.mark.parametrize("ground", GROUND)
def test_what_a_change_is_worth_is_its_density_in_the_noise_of_all_rows(
    case: Conditions, ground: str
) -> None:
    rows, rng = 300, np.random.default_rng(5)
    case = replace(case, ground=ground, quad_kicks={}, ground_laws={})
    case.quad_kicks["x"], case.ground_laws["x"] = wander(case, "x", 1e-4, rng)
    filter_, law = Innovations(case), case.ground_laws["x"]
    kick = np.linspace(0.0, 1e-7, rows)[:, None] * case.kick_orbit(case.lattice.quads[:1], "x").T
    # Where the ground is after each of the steps that chance makes, and what is not known of it.
    powers = np.arange(rows)
    walk = (
        np.cumsum(np.eye(rows), axis=0)
        if law.keep == 1
        else law.keep ** np.subtract.outer(powers, powers).clip(0) * np.tri(rows)
    )
    steps = law.on ** np.abs(np.subtract.outer(powers, powers))
    ground_of_all = walk @ steps @ walk.T
    if law.keep < 1:  # as it was before the first row
        ground_of_all += (
            np.outer(law.keep**powers, law.keep**powers) * law.keep**2 / (1 - law.keep**2)
        )
    worth = sum(
        mode @ np.linalg.solve(power * ground_of_all + 1e8 + np.eye(rows), mode)
        for mode, power in zip((kick / filter_.noise @ filter_.modes).T, filter_.power, strict=True)
    )
    assert np.sum(filter_.whiten(kick) ** 2) == pytest.approx(worth, rel=1e-4)


@pytest.mark.parametrize("ground", GROUND)
def test_innovations_of_the_true_ground_are_white(case: Conditions, ground: str) -> None:
    case = replace(case, ground=ground, quad_kicks={}, ground_laws={})
    rng = np.random.default_rng(4)
    case.quad_kicks["x"], case.ground_laws["x"] = wander(case, "x", 1e-4, rng)
    moved = case.moved_at_bpms()
    readings = moved + rng.standard_normal(moved.shape) * case.noise
    white = Innovations(case).whiten(readings)[50:]
    assert np.var(white) == pytest.approx(1.0, abs=0.02)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.02


@pytest.mark.nightly
def test_healthy_gradients_change_readings_as_the_ring_solved_anew_does(case: Conditions) -> None:
    filter_, seed = Innovations(case), 4
    strength = case.lattice.ring.strength("QUAD")
    scatter = np.abs(strength) * np.std(case.lattice.errors / strength)
    log = run(case, [], seed)
    its = HealthyGradients(case, filter_)
    first_order = np.concatenate([block for _, block in its.changes(log.setpoints)])
    solved = {}
    for quad in (0, 40, 211):
        error = np.where(np.arange(len(scatter)) == quad, scatter, 0.0)
        there = run(case, [(0, Gradients([(0, error)]))], seed, replay=log.sent)
        solved[quad] = filter_.whiten(there.readings - log.readings)
        difference = first_order[:, :, quad] - solved[quad]
        assert np.linalg.norm(difference) < 0.1 * np.linalg.norm(solved[quad])
    # What is one of them is hidden by itself and by the others.
    alone = float(np.linalg.norm(solved[40]))
    assert 0.0 < its.leave(solved[40], log) < alone / np.sqrt(1.0 + alone**2)


@pytest.mark.parametrize("name", ["bpm-gain", "local-kick", "noise-level", "x-weak-bus"])
def test_sizes_are_set_by_detectability(name: str, tmp_path: Path) -> None:
    truth = make(small((name,), background=False), tmp_path, 1).truth
    assert truth["effects"][0]["d_prime"] == pytest.approx(12.0, rel=0.15)


@pytest.mark.nightly
def test_what_knowing_a_wave_gains_later_is_its_orbit_in_the_filter_of_the_noise(
    tmp_path: Path,
) -> None:
    spec = small(("periodic-disturbance",), later=150, background=False)
    truth = make(spec, tmp_path, 1).truth
    case, chosen, log = choose(spec, tmp_path, 1)
    (start, _, draft, size, _), rows = chosen[0], slice(200, len(log.readings))
    wave = draft.build(size)
    wave.start = start
    wave.bind(case, np.random.default_rng(np.random.SeedSequence(spec.seed).spawn(2)[1]))
    motion = wave.motion()
    assert motion is not None
    orbit = motion[case.warm :][rows] / case.noise
    filter_, doubt = Innovations(case), np.full((len(orbit), len(orbit)), 1e8)
    # The density of all rows at once: a walk that nobody knows the beginning of, under noise.
    walk = np.minimum.outer(np.arange(len(orbit)), np.arange(len(orbit)))
    gain = sum(
        0.5 * mode @ np.linalg.solve(power * walk + doubt + np.eye(len(orbit)), mode)
        for mode, power in zip((orbit @ filter_.modes).T, filter_.power, strict=True)
    )
    assert truth["later_oracle_nats"] == pytest.approx(gain, rel=1e-3)
    assert (
        make(replace(spec, effects=("noise-level",)), tmp_path, 1).truth["later_oracle_nats"]
        is None
    )


def test_a_record_is_a_record(tmp_path: Path) -> None:
    record = make(small(dither="shaped"), tmp_path, 1).record
    np.testing.assert_array_equal(record["orbit"][1:], record["next_orbit"][:-1])
    np.testing.assert_allclose(
        record["setpoint"][1:], (record["setpoint"] + record["action"])[:-1], rtol=0, atol=1e-15
    )
    assert np.any(record["dither"])
    # All that is not dither is the loop's answer to the reading.
    lost = np.linalg.lstsq(
        record["orbit"] - record["reference"], record["action"] - record["dither"], rcond=None
    )[1]
    assert not lost.size or np.all(lost < 1e-20)


@pytest.mark.nightly
def test_records_have_the_same_arrays_and_opaque_names(tmp_path: Path) -> None:
    out, truth = tmp_path / "out", tmp_path / "truth"
    for folder in (out, out / "later", truth):
        folder.mkdir(parents=True)
    asked = [(), ("bpm-gain",), ("x-warm-neighbour",), ("clock-jitter",)]
    names = [
        write_case(small(effects, seed=i), opaque(1, i), out, truth, 1)
        for i, effects in enumerate(asked)
    ]
    forms = set()
    for name in names:
        with np.load(out / f"{name}.npz", allow_pickle=False) as file:
            forms.add(tuple((key, file[key].dtype.kind, file[key].ndim) for key in file.files))
            meta = json.loads(str(file["meta"]))
            assert set(meta) == {"dt_s", "units", "planes", "bpm_noise_rms_mm", "note"}
    assert len(forms) == 1
    assert all(len(name) == 12 and not set(name) - set("0123456789abcdef") for name in names)

    digest = seal(out, truth, "quick", 1)
    manifest = json.loads((truth / "manifest.json").read_text())
    assert json.loads((out / "manifest.json").read_text())["truth_sha256"] == digest
    for name in names:
        content = (truth / f"{name}.json").read_bytes()
        assert manifest["files"][f"{name}.json"] == hashlib.sha256(content).hexdigest()
    changed = truth / f"{names[1]}.json"
    changed.write_text(changed.read_text().replace("bpm-gain", "bpm-roll"))
    assert seal(out, truth, "quick", 1) != digest


@pytest.mark.nightly
def test_the_same_seed_makes_the_same_record(tmp_path: Path) -> None:
    first, second = (make(small(("telegraph",)), tmp_path, 1) for _ in range(2))
    for key, values in first.record.items():
        np.testing.assert_array_equal(values, second.record[key])
    assert first.truth == second.truth


def test_makers_name_a_stage_of_the_chain() -> None:
    stages = {"sensor", "actuator", "optics", "disturbance", "noise", "timing"}
    assert {maker.stage for maker in MAKERS.values()} == stages


def test_wilson_interval() -> None:
    # R. G. Newcombe, Stat. Med. 17 (1998) 857, table I: 81 of 263, and 0 of 20
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
