"""What the doctor makes of readings: whether orbits form, their rate, who repeats itself."""

import numpy as np
import pytest

from orbitfb.app.doctor.finding import Verdict
from orbitfb.app.doctor.orbits import Listener, judge
from orbitfb.epics.records import NANOSECONDS
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.settings import LoopSettings

SIZE = 20
NAMES = tuple(f"BPM:{index}" for index in range(SIZE))
BEGIN = 1_164_676_457 * NANOSECONDS


def hear(rate=10.0, ticks=25, apart=0.0, digit=0.0, silent=lambda tick, index: False, **settings):
    """Let a listener hear readings, stamps of each BPM `apart` seconds behind the one before."""
    its = EpicsSettings(**settings)
    listener, rng = Listener(SIZE, its), np.random.default_rng(2)
    for index in range(SIZE):
        listener.assembler.set_connected(index, True)
    for tick in range(ticks):
        for index in range(SIZE):
            if silent(tick, index):
                continue
            stamp = BEGIN + round((tick / rate + index * apart) * NANOSECONDS)
            value = rng.standard_normal()
            value = round(value / digit) * digit if digit else value
            listener.assembler.records[index] = (0, 0, *divmod(stamp, NANOSECONDS), value)
            if listener.arrived():
                listener.complete()
    return listener, its


def found(listener, settings, rate_hz=10.0):
    judged = judge(listener, NAMES, settings, LoopSettings(rate_hz=rate_hz))
    return {each.check: each for each in judged}


@pytest.mark.parametrize("rate", [0.1, 1.0, 10.0, 100.0])
def test_orbits_that_form_are_well_at_any_rate(rate):
    findings = found(*hear(rate), rate_hz=rate)
    assert set(findings) == {"orbits"}
    its = findings["orbits"]
    assert its.verdict is Verdict.OK and its.figures["rate_hz"] == pytest.approx(rate)
    assert its.figures["orbits"] == 25 and its.figures["spread_s"] == 0


def test_stamps_that_lie_apart_fail_and_the_window_that_helps_is_named():
    its = found(*hear(apart=80e-6))["orbits"]
    assert its.verdict is Verdict.FAILED and "none would form" in its.told
    window = float(its.advice.removeprefix("set epics.stamp_window = "))
    listener, settings = hear(apart=80e-6, stamp_window=window)
    assert listener.orbits == 25
    assert found(listener, settings)["orbits"].verdict is Verdict.OK


def test_stamps_as_far_apart_as_the_ticks_need_another_ioc():
    assert "TSEL" in found(*hear(apart=4e-3))["orbits"].advice


@pytest.mark.parametrize(
    ("rate", "verdict"), [(5.0, Verdict.FAILED), (15.0, Verdict.WARNING), (40.0, Verdict.OK)]
)
def test_another_rate_than_that_of_the_loop_is_told(rate, verdict):
    its = found(*hear(rate), rate_hz=20.0)["orbits"]
    assert its.verdict is verdict
    if verdict is not Verdict.OK:
        assert "loop.rate_hz is 20" in its.told and f"loop.rate_hz = {rate:g}" in its.advice


def test_coarse_dead_and_silent_bpms_are_told_apart():
    its = found(*hear(digit=1.0))["repeats"]
    assert "interlocks.bpm_frozen_ticks" in its.advice and its.figures["largest_share"] > 0.2
    its = found(*hear(silent=lambda tick, index: index < 2 and tick % 3 == 1))["updates"]
    assert "BPM:0, BPM:1" in its.told and "MDEL" in its.advice


def test_a_ring_that_sends_nothing_new_is_told():
    its = found(*hear(ticks=2))["orbits"]
    assert its.verdict is Verdict.WARNING and "--deadline" in its.advice
