"""BPMs that are masked by configuration do not count, whatever they say."""

import numpy as np
from scripted import M, N, ScriptedMachine, new_clock

from orbitfb.loop.machines.masked import MaskedMachine

COUNTING = np.arange(N) != 2


def test_a_masked_bpm_is_never_valid_and_the_others_are_what_they_say():
    plain = ScriptedMachine(new_clock())
    machine = MaskedMachine(plain, COUNTING)
    np.testing.assert_array_equal(machine.read(1.0).orbit.valid, COUNTING)
    plain.script.append("many_nan")  # the first four say that they are not valid
    np.testing.assert_array_equal(machine.read(1.0).orbit.valid, np.arange(N) >= 4)


def test_all_else_is_the_machine():
    plain = ScriptedMachine(new_clock())
    machine = MaskedMachine(plain, COUNTING)
    which = np.arange(M) == 1
    machine.write(np.ones(M), which)
    np.testing.assert_array_equal(plain.put[-1], which)
    np.testing.assert_array_equal(machine.setpoints(), which.astype(float))
    assert machine.channels is plain.channels
