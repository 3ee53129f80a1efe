"""What a right model leaves passes every test; what is not white is flagged by its own test."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.gof import audit
from orbitfb.diagnose.gof_follow import BPMS
from orbitfb.diagnose.gof_places import JUMPS, SIZES
from orbitfb.diagnose.gof_slow import CHANNELS, CURRENT
from orbitfb.diagnose.gof_verdict import clearest
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.effects.kicks import source_patterns

RIGHT = ((PLACE, GAIN),)


def flags(its):
    return {test.name for test in its.tests if test.flagged}


def seen(its, white, **other):
    """What tests see of a bench whose innovations are these."""
    known = {"record": its.record, "floor": its.floor, "orbit": its.orbit}
    return SimpleNamespace(**(known | {"currents": its.currents, "white": white} | other))


def disturbed(change):
    """A bench whose innovations at the BPMs are white noise after a change."""
    its = bench(False)
    n = its.white.shape[1]
    channels = np.random.default_rng(3).standard_normal((401, n))
    change(channels)
    return seen(its, its.floor.to_modes(channels))


def test_a_right_model_passes():
    its = audit(bench(True, RIGHT))
    assert clearest(its) is None, flags(its)
    assert len(its.quantiles) > 100
    assert abs(its.autocorrelation[0]) < its.autocorrelation_limit


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_no_gap_passes(seed):
    assert clearest(audit(bench(False, seed=seed))) is None


def test_white_noise_passes():
    assert clearest(audit(disturbed(lambda channels: None))) is None


def test_a_bpm_in_the_tail_of_unequal_healthy_noise_is_no_finding():
    its = bench(False)
    rng = np.random.default_rng(4)
    n = its.white.shape[1]
    spread = np.exp(0.15 * rng.standard_normal(n))
    spread[3] = np.exp(0.3)
    modes = NoiseModes.of(its.record.layout, spread)
    channels = rng.standard_normal((401, n))
    channels[:, 3] *= 1.3  # beyond what the floor takes as this BPM's own

    def flagged(modes):
        floor = replace(its.floor, modes=modes)
        white = channels @ modes.axes
        return flags(audit(seen(its, white, floor=floor)))

    assert flagged(NoiseModes.even(modes.axes)) == {"variance by BPM"}
    assert not flagged(modes)


def test_a_mode_of_one_loud_bpm_is_that_bpm_and_moves_no_more_than_it():
    its = bench(False)
    channels = np.random.default_rng(3).standard_normal((401, its.white.shape[1]))
    channels[:, 3] *= 1.5
    floor = replace(its.floor, modes=NoiseModes.even(np.eye(its.white.shape[1])))
    assert flags(audit(seen(its, channels, floor=floor))) == {"variance by BPM"}


def _louder(channels):
    channels[:, 3] *= 1.5


def _all_louder(channels):
    channels *= 1.1


def _coloured(channels):
    channels[1:, 8] += 0.6 * channels[:-1, 8]


def _all_coloured(channels):
    channels[1:] += 0.1 * channels[:-1]


def _offset(channels):
    channels[:, 5] += 0.5


def _stray(channels):
    channels[100, 30] = 9.0


def _shaken(channels):
    channels[50] *= 1.6


def _later(channels):
    channels[300:, 11] *= 2.0


def _two_alike(channels):
    channels[:, 7] = 0.9 * channels[:, 7] + 0.44 * channels[:, 29]


def _two_opposite(channels):
    channels[:, 7] = 0.9 * channels[:, 7] - 0.44 * channels[:, 29]


def _handed_on(channels):
    channels[1:, 29] = 0.9 * channels[1:, 29] + 0.44 * channels[:-1, 7]


def _crate(channels):
    own = of_a_cell()
    common = np.random.default_rng(8).standard_normal((len(channels), 1))
    channels[:, own] = np.sqrt(0.8) * channels[:, own] + np.sqrt(0.2) * common


def of_a_cell():
    """Columns of the BPMs of one cell."""
    return next(iter(bench(False).record.layout.bpms.groups().values()))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (_two_alike, "correlation of BPMs"),
        (_two_opposite, "correlation of BPMs"),
        (_crate, "correlation of BPMs"),
        (_handed_on, "correlation of BPMs"),
        (_louder, "variance by BPM"),
        (_all_louder, "level of all innovations"),
        (_coloured, "autocorrelation by BPM"),
        (_all_coloured, "autocorrelation"),
        (_offset, "mean by BPM"),
        (_stray, "largest reading"),
        (_shaken, "largest tick"),
        (_later, "steadiness by BPM"),
    ],
)
def test_what_is_not_white_is_flagged(change, name):
    assert name in flags(audit(disturbed(change)))


def test_heavy_tails_are_flagged():
    def heavy(channels):
        channels[:] = np.random.default_rng(1).standard_t(4, channels.shape) / np.sqrt(2.0)

    assert "excess kurtosis" in flags(audit(disturbed(heavy)))


def test_what_follows_a_corrector_is_flagged():
    its = bench(False)

    def late(channels):
        steps = np.diff(its.record.setpoints[:, PLACE], prepend=its.record.setpoints[:1, PLACE])
        pushed = np.outer(np.roll(steps, 2), its.record.layout.response[:, PLACE])
        channels += 3.0 * pushed / np.std(pushed)

    assert "correlation with changes of a corrector" in flags(audit(disturbed(late)))


def test_what_goes_with_the_size_of_another_correctors_change_is_flagged():
    its, other = bench(False), PLACE + 3

    def sags(channels):
        steps = np.diff(its.record.setpoints[:, other], prepend=its.record.setpoints[:1, other])
        pushed = np.outer(np.abs(steps), its.record.layout.response[:, PLACE])
        channels += 0.8 * pushed / np.std(pushed)

    told = {test.name: test for test in audit(disturbed(sags)).tests if test.flagged}
    names = its.record.layout.correctors.names
    assert told[SIZES].note.endswith(f"{names[PLACE]} with {names[other]}")


@pytest.mark.parametrize("rare", [True, False])
def test_ground_that_jumps_is_flagged_and_ground_that_moves_more_is_no_jump(rare):
    its, rng = bench(False), np.random.default_rng(6)
    orbit = source_patterns(its.record.layout)[:, 100]

    def kicks(channels):
        strength = rng.standard_normal(len(channels))
        if rare:
            strength *= 5.0 * (rng.random(len(channels)) < 0.04)
        channels += np.outer(strength, orbit / np.linalg.norm(orbit))

    assert (JUMPS in flags(audit(disturbed(kicks)))) == rare


def test_a_short_record_is_not_tested():
    assert audit(disturbed(lambda channels: None)).tests
    its = bench(False)
    short = seen(its, its.white[:40], record=its.record.rows(0, 40))
    assert not audit(short).tests


def test_a_flag_is_worth_what_its_cause_would_gain():
    """A variance of 4 at one BPM of 400 rows, by the likelihood of the normal law."""

    def louder(channels):
        channels[:, 30] *= 2.0

    worth = clearest(audit(disturbed(louder)))
    assert worth.nats == pytest.approx(200.0 * (3.0 - np.log(4.0)), rel=0.3)


@pytest.mark.parametrize("share", [0.0, 0.07])
def test_a_bpm_that_hears_what_another_one_read_before_is_told(share):
    made = bench(False, seed=8).record
    readings = made.readings.copy()
    readings[1:, 70] += share * made.readings[:-1, 60]
    tests = audit(Bench(replace(made, readings=readings))).tests
    (its,) = (test for test in tests if test.name == BPMS)
    assert its.flagged == (share > 0.0)
    if its.flagged:
        assert its.places[0] == made.layout.bpms.names[70]
        assert "a tick later" in its.note


@pytest.mark.parametrize(("channel", "name"), [("current", CURRENT), ("temperature", CHANNELS)])
@pytest.mark.parametrize("size", [0.0, 3e-7])
def test_bpms_that_all_follow_a_slow_channel_by_a_little_are_told(channel, name, size):
    made = bench(False, seed=9).record
    rng = np.random.default_rng(1)
    course = np.mod(np.arange(len(made)) / 100.0, 1.0)
    own = size * rng.normal(size=180)  # of every BPM far below its noise
    channels = {channel: course, "pressure": np.sin(np.arange(len(made)) / 20.0)}
    its = Bench(replace(made, readings=made.readings + np.outer(course, own), auxiliary=channels))
    tests = {test.name: test for test in audit(its).tests}
    assert tests[name].flagged == (size > 0.0)
    if size:
        assert channel in tests[name].note
