"""`orbitfb` with a first policy that misbehaves when told to; everything else is as it ships.

    python -m tests.chaos.controller MODE_FILE run --ioc …

The first byte of the file says how: `.` well, `n` NaN, `r` raises, `l` late, `h` far too much, `s`
another shape. The law is the one in the slot, whoever put it there; the baseline behind it is not
touched.
"""

import os
import signal
import sys
import time
from typing import Any

import numpy as np

from orbitfb.app.service.active_policy import Keeper
from orbitfb.cli.app import main
from orbitfb.loop.slot import PolicySlot

WORD = "Misbehaving"
LATE = 0.1
"""How long a late policy thinks [s]."""


def misbehaving(policy: Any, file: int) -> Any:
    """Make a policy do what a file says."""
    honest = type(policy).act

    def act(self: Any, error: Any, valid: Any, state: Any) -> Any:
        mode = os.pread(file, 1, 0)
        change, after = honest(self, error, valid, state)
        if mode == b"n":
            return np.full_like(change, np.nan), after
        if mode == b"r":
            raise ArithmeticError("told to")
        if mode == b"l":
            time.sleep(LATE)
        if mode == b"h":
            return 1e6 * change, after
        if mode == b"s":
            return change[:-1], after
        return change, after

    if type(policy).__name__ == WORD:
        return policy
    policy.__class__ = type(WORD, (type(policy),), {"act": act})
    return policy


if __name__ == "__main__":
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # whoever started the campaign may have had nohup
    told = os.open(sys.argv[1], os.O_RDONLY | os.O_CLOEXEC)
    first = Keeper.first
    Keeper.first = lambda *a, **k: misbehaving(first(*a, **k), told)
    swap = PolicySlot.swap  # what the learner promotes obeys too
    PolicySlot.swap = lambda slot, policy: swap(slot, misbehaving(policy, told))
    sys.argv = ["orbitfb", *sys.argv[2:]]
    main()
