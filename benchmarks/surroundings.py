"""Everything that the service runs beside the loop."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from orbitfb.app.setup.stored_policies import trainer
from orbitfb.config.tree import AppConfig
from orbitfb.core.ports import Clock, Subscriber
from orbitfb.core.signals import Channels
from orbitfb.history.archive import ArchiveWriter
from orbitfb.history.buffer import History
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.slot import PolicySlot
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.http import ObserveServer
from orbitfb.observe.logs import configure_logs
from orbitfb.observe.metrics.collector import metrics_registry
from orbitfb.observe.statistics.running import LoopStatistics


class Surroundings:
    """The subscribers of the service, its learner and its metrics, as `orbitfb.service` has them.

    Args:
        channels: Names behind the vectors.
        response: What the learner starts from, shape (n, m) [m/A].
        slot: Where it puts its policies.
        folder: Where log and archive go.
        clock: Clock of the program.
        stack: Closes everything.
    """

    def __init__(
        self,
        channels: Channels,
        response: np.ndarray,
        slot: PolicySlot,
        folder: Path,
        clock: Clock,
        stack: ExitStack,
    ) -> None:
        config = AppConfig()
        stack.callback(configure_logs(config.observe.logs, folder).close)
        statistics = LoopStatistics(channels, config.limits.setpoint, clock)
        events = EventLog(channels, clock, config.observe.logs.quiet_time)
        history = History(channels, config.history.capacity)
        archive = ArchiveWriter(folder / "archive", channels, config.history.archive)
        stack.callback(archive.close)
        learner = LearnerThread(
            trainer(config, response, np.ones(len(channels.correctors), dtype=np.bool_)),
            history,
            slot,
            statistics.refitted,
        )
        learner.start()
        stack.callback(learner.stop)
        registry = metrics_registry(statistics.snapshot, archive.status)
        observe = config.observe.model_copy(update={"port": 0})
        http = ObserveServer(observe, registry, statistics.snapshot)
        http.start()
        stack.callback(http.stop)
        self.subscribers: tuple[Subscriber, ...] = (history, archive, statistics, events)
