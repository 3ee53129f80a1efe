"""The loop of a service: what it excites, what steps the RF, and the runner itself."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.app.commands.frequency import FrequencyCommands
from orbitfb.app.service.access import RingAccess
from orbitfb.app.service.observers import Observers
from orbitfb.app.service.policies import Policies
from orbitfb.app.setup.frequency import follower_of
from orbitfb.app.setup.startup import dither_settings, questioner
from orbitfb.app.setup.stored_policies import safeguards
from orbitfb.config.tree import AppConfig
from orbitfb.core.ports import Clock, Subscriber
from orbitfb.core.signals import Channels, LoopState
from orbitfb.learn.builders import loop_gain
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.excitation.movement import Excitation, Waveform
from orbitfb.loop.runner import Runner
from orbitfb.observe.rf_news import RfNews
from orbitfb.physics.frequency import FrequencyModel


@dataclass(frozen=True, slots=True)
class Loop:
    """The loop, not yet running.

    Args:
        runner: Runs it.
        dither: The small random part of every change.
        excitation: What a file asks for, done once; None: nothing.
        frequency: Commands to the RF.
    """

    runner: Runner
    dither: Dither
    excitation: Excitation | None
    frequency: FrequencyCommands


def build_loop(
    config: AppConfig,
    ioc: str,
    start: LoopState,
    channels: Channels,
    access: RingAccess,
    policies: Policies,
    observers: Observers,
    waveform: Waveform | None,
    model: FrequencyModel | None,
    clock: Clock,
) -> Loop:
    """Put the loop together.

    Args:
        config: The configuration.
        ioc: Where the ring is, as the command line calls it.
        start: State to start in.
        channels: Of the loop.
        access: The ring as the service reaches it.
        policies: What there is to correct with.
        observers: See every tick.
        waveform: What a file asks to excite; None: nothing.
        model: What the RF frequency does; None: it is left alone.
        clock: The time.
    """
    nominal, movable = policies.nominal, access.movable
    dither = Dither(dither_settings(config), nominal.response, loop_gain(nominal), movable)
    excitation = Excitation(waveform, dither) if waveform else None
    follower = follower_of(access.machine.oscillator, model, config, access.obstacle)
    news: tuple[Subscriber, ...] = ()
    if follower is not None:
        news = (RfNews(lambda: follower.sight, clock, observers.reports.rf_told),)
    runner = Runner(
        access.guarded,
        policies.slot,
        config.loop,
        config.limits,
        config.interlocks,
        np.zeros(len(channels.bpms)),
        clock,
        dither=excitation or dither,
        start=start,
        subscribers=(*observers.all, *news),
        counting=access.counting,
        safeguards=replace(
            safeguards(nominal, config, movable),
            obstacle=access.obstacle,
            drive_limits=lambda: access.machine.drive_limits,
        ),
        heed=access.machine.count_bpms,
        random=questioner(config, ioc),
        follower=follower,
        correction=config.correction,
    )
    return Loop(runner, dither, excitation, FrequencyCommands(follower))
