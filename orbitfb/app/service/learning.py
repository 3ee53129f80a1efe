"""The learner of a service, in a thread beside the loop."""

from contextlib import ExitStack

from orbitfb.app.service.access import RingAccess
from orbitfb.app.service.observers import Observers
from orbitfb.app.service.policies import Policies
from orbitfb.app.setup.stored_policies import trainer
from orbitfb.config.tree import AppConfig
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Channels, LoopState
from orbitfb.diagnose.live.broken import Screen
from orbitfb.diagnose.live.watch import GapWatch
from orbitfb.estimation.columns import KnownRf
from orbitfb.learn.answered import AnsweredRows
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.runner import Runner

SHORTEST_POLL, LONGEST_POLL = 0.02, 0.2
"""Bounds of how often the learner looks for new ticks [s]."""


def start_learner(
    config: AppConfig,
    channels: Channels,
    access: RingAccess,
    policies: Policies,
    observers: Observers,
    runner: Runner,
    watch: GapWatch,
    clock: Clock,
    rf: KnownRf | None,
    stack: ExitStack,
) -> LearnerThread | None:
    """Start the learner, if that is wanted; it goes on with the probation that was suspended.

    Args:
        config: The configuration.
        channels: Of the loop.
        access: The ring as the service reaches it.
        policies: What there is to correct with.
        observers: Have what there is to learn from, and are told what comes of it.
        runner: The loop.
        watch: Knows which devices are broken.
        clock: The time.
        rf: What is told of the RF; None: the loop leaves it alone.
        stack: Ends it.
    """
    if not config.learn.enabled:
        return None
    rows = Screen(observers.history, channels, watch.broken, config.interlocks)
    learner = LearnerThread(
        trainer(config, policies.first.response, access.movable, rf),
        rows,
        policies.slot,
        observers.reports.refitted,
        keep=policies.keeper.keep,
        poll=min(LONGEST_POLL, max(SHORTEST_POLL, 2.0 * config.loop.period)),
        limits=config.limits,
        alarmed=observers.reports.alarmed,
        tripped=lambda: runner.state is LoopState.TRIPPED,
        clock=clock,
        records=policies.keeper,
        teaching=AnsweredRows(rows, lambda: runner.believed),
    )
    if going_on := policies.keeper.resumed:
        probation = going_on.probation
        learner.resume(going_on.former, probation.before, probation.seen)
    learner.start()
    stack.callback(learner.stop)
    return learner
