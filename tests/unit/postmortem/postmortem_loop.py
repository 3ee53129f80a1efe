"""A loop on a small scripted ring with a recorder of post-mortems beside it."""

import importlib.util
import sys
from pathlib import Path

import numpy as np

from orbitfb.core.signals import LoopState
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.postmortem.recorder import Listeners, PostMortemRecorder, Run
from orbitfb.postmortem.settings import PostMortemSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


def _scripted():
    """The scripted ring of the tests of the loop, wherever pytest looked first."""
    if "scripted" not in sys.modules:
        path = Path(__file__).parents[1] / "loop/scripted.py"
        spec = importlib.util.spec_from_file_location("scripted", path)
        sys.modules["scripted"] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules["scripted"])
    return sys.modules["scripted"]


ring = _scripted()
CONFIGURATION = "seed = 7\n\n[interlocks]\nreadback_tolerance = 0.2\n"
PATIENCE = 20.0
"""How long a thread may take on a loaded computer [s]."""


class Loop:
    """A closed loop and its recorder; what the recorder said is in lists.

    Args:
        directory: Of the post-mortems.
        settings: What is kept: 3 s before and 1 s after unless told otherwise.
    """

    def __init__(self, directory, **settings):
        self.clock = ring.new_clock()
        self.machine = ring.ScriptedMachine(self.clock)
        self.directory = directory
        self.written, self.failed, self.removed = [], [], []
        self.recorder = PostMortemRecorder(
            directory,
            PostMortemSettings(**{"before": 3.0, "after": 1.0} | settings),
            Run(self.machine.channels, np.ones(ring.N, dtype=bool), CONFIGURATION, {"ioc": "x"}),
            Listeners(
                lambda path, frozen: self.written.append((path, frozen)),
                self.failed.append,
                self.removed.append,
            ),
            self.clock,
        )
        self.slot = PolicySlot(ring.InversePolicy())
        self.records = []
        self.runner = Runner(
            self.machine,
            self.slot,
            LoopSettings(),
            LimitSettings(),
            InterlockSettings(),
            np.zeros(ring.N),
            self.clock,
            start=LoopState.CLOSED,
            subscribers=(self.recorder, self.records.append),
            random=np.random.default_rng(1),
        )

    def ticks(self, count, *events):
        """Tick that often; the first ones with these events of the script."""
        self.machine.script.extend(events)
        for _ in range(count):
            self.runner.step()

    def reset(self):
        """Reset a tripped loop and close it again."""
        self.runner.command("reset")
        self.ticks(1)
        self.runner.command("close")
        self.ticks(1)

    def settle(self):
        """Stop the recorder: everything is on disk, or given up, after it."""
        self.recorder._stop.set()
        self.recorder._wake.set()
        self.recorder._thread.join(PATIENCE)
        assert not self.recorder._thread.is_alive()

    def files(self):
        return sorted(self.directory.glob("*.h5"))
