"""Effects of correctors against closed forms, an independent solver, and hidden steps."""

from dataclasses import replace

import numpy as np
import pytest
from actuator_courses import PLACES, course, nominal, record_of
from numpy.testing import assert_allclose
from scipy.signal import StateSpace, lsim

from orbitfb.effects.registry import effect
from orbitfb.physics.effect import Effect


def test_a_lag_answers_a_step_as_an_exponential(layout):
    step = np.zeros((40, 1))
    step[5:] = 1.0
    record = record_of(layout, np.repeat(step, 180, axis=1))
    got = effect("corrector-lag").drive(step, {"tau": 0.25}, record)[:, 0]
    since = (np.arange(40) - 4) * layout.period  # set after reading 4, in force at reading 5
    assert_allclose(got, np.where(since > 0, 1 - np.exp(-since / 0.25), 0), rtol=0, atol=1e-14)


def follows(system, rest, layout, kind, values):
    """Compare an effect with what a solver makes of a system that begins at rest."""
    setpoints, fine = course(6, 1, rows=60), 200
    held = np.repeat(setpoints[1:, 0], fine)  # row k is in force from reading k − 1 to k
    held = np.append(held, held[-1])
    time = np.arange(len(held)) * layout.period / fine
    start = setpoints[0, 0] * np.array(rest)
    _, answer, _ = lsim(system, held, time, X0=start, interp=False)
    got = effect(kind).drive(setpoints, values, record_of(layout, setpoints))
    assert_allclose(got[:, 0], answer[::fine], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("frequency", "damping"), [(0.5, 0.02), (3.0, 0.3), (8.0, 0.1), (1, 0.9)])
def test_a_resonance_follows_its_differential_equation(layout, frequency, damping):
    omega = 2 * np.pi * frequency
    system = StateSpace(
        [[0, 1], [-(omega**2), -2 * damping * omega]], [[0], [omega**2]], [[1, 0]], [[0]]
    )
    values = {"frequency": frequency, "damping": damping}
    follows(system, [1, 0], layout, "corrector-resonance", values)


@pytest.mark.parametrize(("tau", "second"), [(0.3, 0.05), (0.02, 0.4), (0.1, 0.1), (2.0, 1e-3)])
def test_a_lag_with_two_time_constants_follows_its_differential_equation(layout, tau, second):
    system = StateSpace(
        [[-1 / tau, 1 / tau], [0, -1 / second]], [[0], [1 / second]], [[1, 0]], [[0]]
    )
    follows(system, [1, 1], layout, "corrector-lag", {"tau": tau, "second": second})


def test_a_slew_limit_lets_small_steps_pass_and_finishes_large_ones(layout):
    setpoints = np.zeros((8, 180))
    setpoints[1:] = 1e-3
    setpoints[3:] = 6e-3
    got = effect("corrector-slew").drive(setpoints, {"rate": 0.02}, record_of(layout, setpoints))
    assert_allclose(got[:, 0], [0, 1e-3, 1e-3, 3e-3, 5e-3, 6e-3, 6e-3, 6e-3], atol=1e-15)


def test_a_dead_band_releases_small_steps_together(layout):
    ramp = np.arange(9.0)[:, None] * 1e-3 * np.ones(180)
    got = effect("corrector-deadband").drive(ramp, {"width": 2.5e-3}, record_of(layout, ramp))
    assert_allclose(got[:, 0], [0, 0, 0, 3e-3, 3e-3, 3e-3, 6e-3, 6e-3, 6e-3], atol=1e-15)


def test_play_follows_half_a_width_behind_and_waits_at_reversals(layout):
    up, down = np.arange(0.0, 6.0), np.arange(4.0, -1.0, -1.0)
    triangle = np.concatenate([up, down])[:, None] * 1e-3 * np.ones(180)
    kind = effect("corrector-hysteresis")
    got = kind.drive(triangle, {"width": 3e-3, "share": 1.0}, record_of(layout, triangle))
    want = [0, 0, 0.5, 1.5, 2.5, 3.5, 3.5, 3.5, 3.5, 2.5, 1.5]
    assert_allclose(got[:, 0], 1e-3 * np.array(want), atol=1e-15)


def pull_of(true_error, rows, noise):
    """∂log L/∂current for an error that is there, with its noise."""
    rng = np.random.default_rng(11)
    return (true_error + noise * rng.standard_normal(rows.shape)) * 1e8


@pytest.mark.parametrize("offset", [0.0, pytest.param(0.7, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(
    "step",
    [
        pytest.param(0.4e-3, marks=pytest.mark.nightly),
        1.1e-3,
        pytest.param(3.07e-3, marks=pytest.mark.nightly),
    ],
)
@pytest.mark.parametrize("where", [pytest.param("all", marks=pytest.mark.nightly), "one"])
def test_the_needle_of_a_quantisation_is_found(layout, step, offset, where):
    kind, rng = effect("corrector-quantisation"), np.random.default_rng(10)
    setpoints = offset * rng.standard_normal(180) + course(10, 180, rows=1500, size=0.2e-3)
    record = record_of(layout, setpoints)
    error = kind.drive(setpoints, {"step": step}, record) - setpoints
    if where == "one":
        error[:, np.arange(180) != 17] = 0.0
    places = slice(None) if where == "all" else slice(17, 18)

    def likeness(values):
        told = (kind.drive(setpoints, values, record) - setpoints)[:, places].ravel()
        true = error[:, places].ravel()
        return told @ true / np.sqrt((told @ told) * (true @ true))

    # half a turn of the largest setpoint away from the tip most of it is gone
    assert likeness({"step": step + 0.5 * step**2 / np.max(np.abs(setpoints[:, places]))}) < 0.5
    hints = kind.hints(setpoints, pull_of(error, setpoints, 5e-4), record)
    best = max(hints, key=likeness)
    assert likeness(best) > 0.9
    assert best["step"] == pytest.approx(step, rel=1e-4 if where == "all" else 5e-3)


def test_the_step_of_a_readback_is_read_off(layout):
    kind, setpoints = effect("corrector-quantisation"), course(10, 180, rows=300)
    rounded = kind.drive(setpoints, {"step": 1.234e-3}, record_of(layout, setpoints))
    record = record_of(layout, setpoints, readback=rounded)
    assert kind.grid(record)[0]["step"] == pytest.approx(1.234e-3, rel=1e-6)
    noisy = rounded + 1e-4 * np.random.default_rng(0).standard_normal(rounded.shape)
    bare, with_noise = (kind.grid(replace(record, readback=columns)) for columns in (None, noisy))
    assert with_noise == bare


def test_nothing_in_a_resonance_that_is_infinitely_stiff(layout):
    assert (
        type(
            effect("corrector-resonance").simulate(
                layout, PLACES, nominal(effect("corrector-resonance")), np.random.default_rng(0)
            )
        )
        is Effect
    )
