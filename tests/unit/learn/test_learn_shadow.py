"""A candidate in shadow: what it is told, what it would have done, why it is refused."""

import numpy as np
import pytest

from orbitfb.core.transitions import Transitions
from orbitfb.learn.settings import ShadowSettings
from orbitfb.learn.shadow import Shadow
from orbitfb.safety.limits import LimitSettings

N = 6
RESPONSE = 1e-3 * np.diag(np.linspace(3.0, 0.5, N))
RIGHT = np.linalg.inv(RESPONSE)


class Law:
    """a = −g R⁻¹ e."""

    def __init__(self, gain):
        self.policy_id, self.gain = f"law-{gain}", gain
        self.asked = []

    def initial_state(self):
        return 0

    def act(self, error, valid, state):
        self.asked.append((error, valid, state))
        return -self.gain * RIGHT @ error, state + 1


def loop(gain, ticks, first=0, closed=True, orbit=50e-6, noise=0.0, seed=1, dither=0.0):
    """Transitions of a loop under a law, from an orbit that is off."""
    random = np.random.default_rng(seed)
    law = Law(gain)
    s = orbit * random.standard_normal(N)
    read = s + noise * random.standard_normal(N)
    rows = {"orbit": [], "applied": [], "next": [], "dither": []}
    for _ in range(ticks):
        extra = dither * random.standard_normal(N)
        change = law.act(read, None, 0)[0] + extra
        s = s + RESPONSE @ change
        after = s + noise * random.standard_normal(N)
        for name, value in zip(rows, (read, change, after, extra), strict=True):
            rows[name].append(value)
        read = after
    columns = {name: np.array(value) for name, value in rows.items()}
    time, yes = 0.1 * np.arange(ticks), np.ones(ticks, dtype=bool)
    zeros = np.zeros((ticks, N))
    return Transitions(
        tick=first + np.arange(ticks),
        time=time,
        next_time=time + 0.1,
        written=time,
        orbit=columns["orbit"],
        next_orbit=columns["next"],
        reference=zeros,
        valid=np.ones((ticks, N), dtype=bool),
        requested=columns["applied"],
        applied=columns["applied"],
        dither=columns["dither"],
        setpoints=zeros,
        readback=zeros,
        policy_id=np.full(ticks, law.policy_id),
        closed=yes if closed else ~yes,
        hertz=np.zeros(ticks),
        usable=yes,
        auxiliary={},
    )


def shadow(candidate, least=0.0, **settings):
    limits = LimitSettings(change_per_tick=1.0)
    chosen = ShadowSettings(**{"ticks": 20} | settings)
    return Shadow(candidate, Law(0.2), RESPONSE, chosen, limits, 0, 0.0, least)


def test_it_tells_the_orbit_that_the_candidate_would_have_left():
    """One step of a law of gain 1 leaves nothing, whatever the incumbent left, dither apart."""
    trial = shadow(Law(1.0))
    rows = loop(0.2, 20, dither=1e-3)
    trial.take(rows, 1.0)
    verdict = trial.verdict(1.0)
    left_by_dither = np.sqrt(np.mean((rows.dither @ RESPONSE.T) ** 2))
    assert verdict.accepted
    assert verdict.figures["shadow_rms_candidate"] == pytest.approx(left_by_dither, rel=1e-9)
    assert verdict.figures["shadow_rms_incumbent"] > 2 * left_by_dither
    assert trial.candidate.asked[-1][2] == 19  # its own state, carried on


def test_the_comparison_is_fair_at_the_noise_floor():
    """Gain 1 writes all of the noise to the orbit, gain 0.2 little: seen through fresh noise."""
    trial = shadow(Law(1.0), ticks=3000, margin=0.0)
    trial.take(loop(0.2, 3000, orbit=0.0, noise=0.2e-6), 1.0)
    figures = trial.verdict(1.0).figures
    assert figures["shadow_rms_candidate"] == pytest.approx(0.2e-6 * np.sqrt(2), rel=0.02)
    assert figures["shadow_rms_incumbent"] == pytest.approx(0.2e-6 * np.sqrt(1 / 0.9), rel=0.02)
    assert not trial.verdict(1.0).accepted


def test_worse_is_refused_and_a_little_worse_is_not():
    rows = loop(0.5, 20)
    for gain, accepted in ((-0.5, False), (0.499, True)):
        trial = shadow(Law(gain))
        trial.take(rows, 1.0)
        verdict = trial.verdict(1.0)
        assert verdict.accepted is accepted
        assert ("worse" in verdict.reason) is not accepted


def test_a_model_that_expects_far_more_motion_than_there_is_is_not_believed():
    rows = loop(0.2, 20, dither=1e-3)
    left = np.sqrt(np.mean(rows.next_orbit**2))
    for least, accepted in ((0.5 * left, True), (2.0 * left, False)):
        trial = shadow(Law(1.0), least)
        trial.take(rows, 1.0)
        verdict = trial.verdict(1.0)
        assert verdict.accepted is accepted
        assert ("not believed" in verdict.reason) is not accepted


def test_a_change_beyond_the_limits_is_refused_when_the_incumbent_stayed_within():
    trial = shadow(Law(1.0))
    trial.take(loop(0.2, 3, orbit=2e-3), 1.0)
    verdict = trial.verdict(1.0)
    assert not verdict.accepted and "beyond the limits" in verdict.reason


def test_a_change_that_is_not_finite_is_refused():
    trial = shadow(Law(float("nan")))
    trial.take(loop(0.2, 1), 1.0)
    assert "not finite" in trial.verdict(1.0).reason


def test_it_waits_for_closed_ticks_but_not_for_ever():
    trial = shadow(Law(1.0), patience=5.0)
    trial.take(loop(0.2, 10), 1.0)
    assert trial.verdict(1.0) is None
    trial.take(loop(0.2, 10, first=10, closed=False), 4.0)
    assert trial.next_tick == 20
    assert trial.verdict(6.0) is None
    verdict = trial.verdict(6.1)
    assert not verdict.accepted and "10 of 20 closed ticks" in verdict.reason


def test_masked_bpms_do_not_count():
    rows = loop(0.2, 20)
    rows.valid[:, 0] = False
    rows.orbit[:, 0] = rows.next_orbit[:, 0] = np.nan
    trial = shadow(Law(1.0))
    trial.take(rows, 1.0)
    verdict = trial.verdict(1.0)
    assert verdict.accepted and np.isfinite(verdict.figures["shadow_rms_candidate"])
    assert all(np.isfinite(error).all() for error, _, _ in trial.candidate.asked)


def test_a_candidate_that_learns_is_told_what_the_incumbent_sent():
    class Learning(Law):
        def inform(self, error, valid, applied, state):
            told.append(applied)
            return state

    told, rows = [], loop(0.2, 20, dither=1e-3)
    trial = shadow(Learning(1.0))
    trial.take(rows, 1.0)
    np.testing.assert_array_equal(told, rows.applied)
