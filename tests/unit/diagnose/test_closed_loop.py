"""The simulated loop has the orbit that was measured, with the right cause."""

from dataclasses import replace

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench, record

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.closed_loop import closed_loop, mended_response
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.loop_law import linear_law, reference_of
from orbitfb.diagnose.loop_run import Runs, effects_of, run_loop
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.places import Ring
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def test_the_law_is_found():
    its = record(False)
    law, follows = linear_law(its)
    policy = SvdPolicy(its.layout.response, SvdSettings(gain=0.35, regularisation=70e-6))
    assert follows > 0.999
    assert law == pytest.approx(policy.gain_matrix, abs=1e-3 * np.abs(policy.gain_matrix).max())


def test_the_measured_rms_is_predicted():
    its = closed_loop(bench(True, ((PLACE, GAIN),)))
    assert its.measured_low <= its.measured_um <= its.measured_high
    assert its.with_um == pytest.approx(its.measured_um, rel=0.05)
    assert its.radius_with < 1.0


def test_a_gain_error_changes_one_column():
    its = bench(True, ((PLACE, GAIN),))
    nominal = its.record.layout.response
    mended = mended_response(its.record, its.causes)
    assert mended[:, PLACE] == pytest.approx(nominal[:, PLACE] * (1 + GAIN))
    assert np.delete(mended, PLACE, 1) == pytest.approx(np.delete(nominal, PLACE, 1))


def lagging(tau=0.3, places=tuple(range(0, 180, 2))):
    return Cause(effect("corrector-lag"), places, {"tau": tau})


@pytest.fixture(scope="module")
def slow():
    ring = Ring.load()
    cause = lagging()
    own = cause.kind.simulate(
        layout_of(ring, "x", 0.1), np.array(cause.places), cause.values, np.random.default_rng(0)
    )
    return Bench(simulate_record(ring, ticks=400, seed=5, effects=[own], dither=1e-3), [cause])


def test_a_lag_is_predicted_in_the_closed_loop(slow):
    its = closed_loop(slow)
    assert its.with_um == pytest.approx(its.measured_um, rel=0.05)
    assert abs(its.without_um - its.measured_um) > 2.0 * abs(its.with_um - its.measured_um)
    assert its.with_low <= its.with_um <= its.with_high
    assert its.radius_with is None
    measured, without, mended = (
        np.log(spectrum) for spectrum in (its.psd_measured, its.psd_without, its.psd_with)
    )
    assert np.mean((mended - measured) ** 2) < 0.5 * np.mean((without - measured) ** 2)


def test_the_spectrum_has_the_power_of_the_orbit(slow):
    its = closed_loop(slow)
    width = its.frequency_hz[1] - its.frequency_hz[0]
    assert np.sum(its.psd_measured) * width == pytest.approx(its.measured_um**2, rel=0.2)


def test_a_short_later_record_is_predicted_by_the_law_of_the_first(slow):
    later = slow.record.rows(300, 401)
    assert linear_law(later)[0] is None
    assert linear_law(later, slow.record)[0] is not None
    its = closed_loop(slow, later)
    assert its.with_um == pytest.approx(its.measured_um, rel=0.1)


@pytest.mark.parametrize(
    ("name", "places"), [("bpm-polarity", (20, 90)), ("bpm-swap", (31,)), ("bpm-stuck", (7,))]
)
def test_a_loop_begins_with_the_readings_of_the_record(name, places):
    its = simulate_record(Ring.load(), ticks=120, seed=6)
    standing = replace(its, readings=its.readings + 300e-6 * np.cos(np.arange(180.0)))
    acting = effects_of((Cause(effect(name), places, {}),), its.layout, 0, onsets=False)
    law = np.zeros((its.setpoints.shape[1], its.readings.shape[1]))
    off = run_loop(Runs(standing, Bench(its).floor, law, [acting], seed=0))[0]
    first = off[0] - (standing.readings[0] - reference_of(standing)[0])
    np.testing.assert_allclose(first, 0.0, atol=5e-6)


def test_noise_cannot_be_parted_from_the_floor():
    its = bench(False)
    found = closed_loop(its, causes=(Cause(effect("noise-level"), (0,), {"factor": 2.0}),))
    assert found.with_um is None
    assert "noise-level" in found.note
    assert found.without_um is not None


def test_too_few_ticks_are_said_to_be_too_few(slow):
    found = closed_loop(Bench(slow.record.rows(0, 120)))
    assert found.without_um is None
    assert "too few ticks" in found.note
