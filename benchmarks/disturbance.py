"""What may go on beside the loop: swaps of the policy, refits without a pause."""

import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager

import numpy as np

from orbitfb.config.tree import AppConfig
from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import LoopState
from orbitfb.core.transitions import Transitions
from orbitfb.history.buffer import History
from orbitfb.learn.builders import builder
from orbitfb.learn.learner import Learner
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.svd import SvdPolicy
from orbitfb.sim.job import SimJob

SWAP_EVERY = 0.35  # [s]
TAUGHT_TICKS = 2000


@contextmanager
def disturbed(kind: str, slot: PolicySlot, job: SimJob) -> Generator[None, None, None]:
    """Disturb the loop from a thread of its own until the block ends.

    Args:
        kind: `nothing`, `swaps` or `refits`.
        slot: Where policies are swapped.
        job: The ring whose transitions a refit is made from.
    """
    over = threading.Event()
    if kind == "nothing":
        yield
        return
    work = _swapping(slot, over) if kind == "swaps" else _refitting(slot, job, over)
    thread = threading.Thread(target=lambda: list(work), name=kind, daemon=True)
    next(work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _swapping(slot: PolicySlot, over: threading.Event) -> Iterator[None]:
    first = slot.current
    if not isinstance(first, SvdPolicy):
        raise TypeError("only SVD policies are swapped here")
    spare = SvdPolicy(first.response * 1.01, first.settings)
    yield
    while not over.wait(SWAP_EVERY):
        slot.swap(spare if slot.current is first else first)


def _refitting(slot: PolicySlot, job: SimJob, over: threading.Event) -> Iterator[None]:
    """Refit from scratch, over and over, without putting the outcome in force."""
    config, incumbent = AppConfig(), slot.current
    if not isinstance(incumbent, SvdPolicy):
        raise TypeError("only SVD policies are refitted here")
    transitions = _taught(job, incumbent)
    yield
    while not over.is_set():
        learner = Learner(incumbent.response, config.learn, builder(config.policy))
        learner.refit(transitions, incumbent, "on-demand")


def _taught(job: SimJob, policy: SvdPolicy) -> Transitions:
    """Let the loop run in process, without Channel Access, and keep its transitions."""
    plant, _ = job.build()
    config, clock = AppConfig(), ManualClock()
    history = History(plant.channels, TAUGHT_TICKS)
    machine = PlantMachine(plant, clock)
    runner = Runner(
        machine,
        PolicySlot(policy),
        config.loop,
        config.limits,
        config.interlocks,
        np.zeros(len(plant.channels.bpms)),
        clock,
        start=LoopState.CLOSED,
        subscribers=(history,),
    )
    for _ in range(TAUGHT_TICKS):
        runner.step()
    return history.snapshot()
