"""The measured response is that of the ring, by steps and at once, whatever disturbs it."""

import numpy as np
import pytest
from measured_ring import (
    NOISY,
    NOMINAL,
    QUIET,
    Bench,
    Lagging,
    Late,
    Ramp,
    Saturating,
    Stuck,
    Unplugged,
)
from numpy.testing import assert_allclose, assert_array_equal

from orbitfb.core.errors import MeasurementError
from orbitfb.measure.regression import fit_column
from orbitfb.measure.sequence import levels
from orbitfb.physics.plant import PlantSettings


def apart(found, true):
    return np.linalg.norm(found - true) / np.linalg.norm(true)


def test_without_noise_it_is_the_rings_own_and_not_the_optics(tmp_path):
    bench = Bench(tmp_path)
    found = bench.measured(bench.run())
    assert apart(found, bench.true) < 1e-9
    assert apart(NOMINAL[:, list(bench.correctors)], bench.true) > 0.02


@pytest.mark.parametrize("at_once", [1, 0])
def test_with_noise_it_is_as_uncertain_as_it_says(tmp_path, at_once):
    bench = Bench(tmp_path, NOISY, correctors=tuple(range(0, 180, 20)))
    result = bench.run(at_once=at_once)
    off = bench.measured(result) - bench.true
    sigma = result.table.sigma[:, list(bench.correctors)]
    assert 0.93 < np.sqrt(np.mean(off**2) / np.mean(sigma**2)) < 1.07
    assert apart(bench.measured(result), bench.true) < 0.01


def test_how_much_of_the_waveform_is_played_is_told_after_each_orbit(tmp_path):
    bench = Bench(tmp_path, correctors=tuple(range(0, 180, 20)))
    bench.run(at_once=0)
    assert len(bench.played) > 400 and bench.played[-1] == 1.0
    assert min(np.diff(bench.played)) > 0 and max(np.diff(bench.played)) < 0.01


@pytest.mark.parametrize("at_once", [1, 0])
def test_on_a_ring_that_moves_as_rings_do(tmp_path, at_once):
    bench = Bench(tmp_path, PlantSettings(), correctors=tuple(range(0, 180, 12)))
    result = bench.run(at_once=at_once)
    assert apart(bench.measured(result), bench.true) < 0.02
    assert not bench.judged(result).correctors and not bench.judged(result).bpms


def test_the_steps_are_bipolar_and_blind_to_a_linear_drift():
    for sizes, repeats in ((2, 1), (3, 2), (5, 3)):
        steps = levels(sizes, repeats)
        order = np.arange(len(steps))
        assert_allclose([steps.sum(), steps @ order], 0.0, atol=1e-12)
        assert_array_equal(np.unique(steps), np.unique(-steps))
        assert len(np.unique(np.abs(steps))) == sizes


def test_a_linear_drift_cancels_as_it_does_not_one_sided(tmp_path):
    drift = Ramp(np.random.default_rng(3).normal(0.0, 0.3e-6, 180))
    bench = Bench(tmp_path, effects=(drift,))
    assert apart(bench.measured(bench.run()), bench.true) < 1e-7
    # The same drift, one step up and the two orbits subtracted, as it is often done.
    machine, corrector = bench.machine, bench.correctors[0]
    before = [machine.read(1.0) for _ in range(4)]
    machine.write(bench.base + 0.15 * (np.arange(180) == corrector))
    after = [machine.read(1.0) for _ in range(6)][2:]
    one_sided = np.mean([r.orbit.position for r in after], axis=0)
    one_sided -= np.mean([r.orbit.position for r in before], axis=0)
    assert apart(one_sided / 0.15, bench.true[:, 0]) > 0.03


def test_the_order_of_the_steps_alone_takes_the_drift_out():
    steps = levels(2, 1)
    orbit = 2.0 * steps + 5.0 * np.arange(8)
    assert steps @ orbit / (steps @ steps) == pytest.approx(2.0)
    assert fit_column(steps, np.arange(8.0), orbit[:, None]).noise == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("at_once", [1, 0])
def test_a_corrector_that_saturates_is_not_linear(tmp_path, at_once):
    bench = Bench(tmp_path, NOISY, correctors=(3, 40, 41, 100, 120, 140, 150, 160, 179))
    amplitude = 50e-6 / np.sqrt(np.mean(NOMINAL[:, 40] ** 2))
    size = amplitude * (1.0 if at_once == 1 else np.sqrt(2 / 9))
    room = abs(bench.base[40]) + 0.7 * size  # of the larger steps it makes 70 %
    bench = Bench(tmp_path, NOISY, (Saturating(40, room),), correctors=bench.correctors)
    result = bench.run(at_once=at_once)
    named = bench.judged(result).correctors
    assert set(named) == {bench.machine.channels.correctors[40]}
    assert "not linear" in named[bench.machine.channels.correctors[40]]
    assert result.table.linearity[40] > 0.02
    others = [j for j in bench.correctors if j != 40]
    assert np.nanmax(result.table.linearity[others]) < 0.02


@pytest.mark.parametrize("at_once", [1, 0])
def test_a_dead_corrector_and_a_dead_bpm_are_named(tmp_path, at_once):
    quiet = NOISY.model_copy(update={"drift": PlantSettings().drift})
    correctors = (3, 40, 41, 100, 179)
    bench = Bench(tmp_path, quiet, (Unplugged(41), Stuck(7)), correctors=correctors)
    judgement = bench.judged(bench.run(at_once=at_once))
    channels = bench.machine.channels
    assert set(judgement.correctors) == {channels.correctors[41]}
    assert set(judgement.bpms) == {channels.bpms[7]}
    assert "dead" in judgement.correctors[channels.correctors[41]]
    assert "dead" in judgement.bpms[channels.bpms[7]]


def test_a_readback_that_does_not_follow_is_named(tmp_path):
    class HalfRead(Saturating):
        def actuate(self, setpoints, tick):
            return np.where(np.arange(180) == self.corrector, 0.8 * setpoints, setpoints)

    bench = Bench(tmp_path, effects=(HalfRead(40, 0.0),))
    judgement = bench.judged(bench.run(settle_most=3))
    assert "does not follow" in judgement.correctors[bench.machine.channels.correctors[40]]


def test_a_corrector_that_lags_is_waited_for_by_steps_and_named_at_once(tmp_path):
    bench = Bench(tmp_path, effects=(Lagging(40, 0.5),))
    result = bench.run()
    assert apart(bench.measured(result), bench.true) < 0.02
    assert not bench.judged(result).correctors
    bench = Bench(tmp_path, effects=(Lagging(40, 0.5),))
    named = bench.judged(bench.run(at_once=0, agreement=0.9)).correctors
    assert "lags" in named[bench.machine.channels.correctors[40]]


def test_at_once_is_as_by_steps_in_a_quarter_of_the_time(tmp_path):
    every = tuple(range(80))
    whole = {}
    for at_once in (1, 0):
        bench = Bench(tmp_path, NOISY, correctors=every)
        found = bench.measured(bench.run(at_once=at_once))
        whole[at_once] = found, bench.machine.plant.tick
        assert apart(found, bench.true) < 0.01
    assert apart(whole[1][0], whole[0][0]) < 0.01
    assert whole[0][1] * 4 < whole[1][1]


def test_at_once_a_column_that_by_steps_is_another_is_refused(tmp_path):
    # All of them lag alike: no phase tells, but the size by steps is another.
    class Slow(Lagging):
        def actuate(self, setpoints, tick):
            self.now = self.now + self.part * (setpoints - self.now)
            return self.now.copy() if isinstance(self.now, np.ndarray) else setpoints

    bench = Bench(tmp_path, effects=(Slow(0, 0.3),))
    with pytest.raises(MeasurementError, match="off that by steps"):
        bench.run(at_once=0)
    assert_array_equal(bench.machine.setpoints(), bench.base)


def test_orbits_that_are_missing_do_no_harm(tmp_path):
    for at_once in (1, 0):
        bench = Bench(tmp_path, QUIET)
        bench.machine.at = {
            60: lambda machine: machine.fail_next_reads(2),
            90: lambda machine: machine.mask(*range(30)),
            93: lambda machine: machine.unmask(),
            150: lambda machine: machine.fail_next_reads(1),
        }
        assert apart(bench.measured(bench.run(at_once=at_once)), bench.true) < 1e-6


def test_writes_that_come_a_tick_late_do_no_harm(tmp_path):
    for at_once, every in ((1, 40), (0, 2)):
        bench = Bench(tmp_path, effects=(Late(0.1),), correctors=tuple(range(0, 180, every)))
        assert apart(bench.measured(bench.run(at_once=at_once)), bench.true) < 1e-6
