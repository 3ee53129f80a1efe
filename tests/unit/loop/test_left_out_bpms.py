"""What the machine says of a BPM that it left out is what the loop tells; who counts is told it."""

from dataclasses import replace

import numpy as np
from scripted import InversePolicy, M, N, ScriptedMachine, new_clock

from orbitfb.core.signals import LoopState
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


class Stray(ScriptedMachine):
    """BPM2 carries another stamp than the others."""

    def read(self, timeout):
        reading = super().read(timeout)
        valid = np.arange(N) != 2
        orbit = replace(reading.orbit, valid=valid)
        told = {2: "stamped 1 ms ahead of the others"}
        return replace(reading, orbit=orbit, left_out=told)


def loop_with(heed=None):
    machine = Stray(new_clock())
    return Runner(
        machine,
        PolicySlot(InversePolicy()),
        LoopSettings(ramp=0.0, proving=2),
        LimitSettings(),
        InterlockSettings(),
        np.zeros(N),
        machine.clock,
        start=LoopState.CLOSED,
        heed=heed,
    )


def test_the_reason_names_the_bpm_that_strays_and_what_it_does():
    runner = loop_with()
    for _ in range(6):
        record = runner.step()
    assert record.state is LoopState.CLOSED
    assert record.reason == "1 of 6 BPMs are invalid: BPM2 (stamped 1 ms ahead of the others)"


def test_the_machine_hears_which_bpms_count_when_operators_change_it():
    heard = []
    runner = loop_with(heard.append)
    runner.step()
    assert not heard
    enabled = np.arange(N) != 2
    wanted = replace(Adjustments.none(np.zeros(N), M), enabled=enabled)
    runner.adjust(wanted)
    runner.step()
    runner.step()
    (counting,) = heard
    np.testing.assert_array_equal(counting, enabled)
    assert not runner.reason
