"""The panel of the service's own: started with it, watched, started again, stopped with it."""

import threading
from contextlib import ExitStack

import structlog

from orbitfb.app.commands.vectors import still_vectors
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.signals import Channels
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.panel.job import PanelJob
from orbitfb.sim.child import ServerChild

_log = structlog.stdlib.get_logger("orbitfb.service")

LOOK_PERIOD = 0.5
"""How often to look whether it is alive [s]."""
LONGEST_PAUSE = 60.0
"""Longest time between two attempts to start it again [s]."""


class PanelProcess:
    """Serves the panel from a child process: the loop never waits for it.

    Args:
        config: Of the service.
        channels: Of the loop.
        statistics: Told when it died.
        stack: Stops it.

    Raises:
        OrbitFeedbackError: It does not start: a wrong rule, a port that is taken.
    """

    def __init__(
        self,
        config: AppConfig,
        channels: Channels,
        statistics: LoopStatistics,
        stack: ExitStack,
    ) -> None:
        job = PanelJob(
            data_directory=config.data_directory.resolve(),
            panel=config.panel.model_copy(
                update={"rules": config.panel.rules and config.panel.rules.resolve()}
            ),
            planes=config.ring.planes,
            bpms=len(channels.bpms),
            correctors=len(channels.correctors),
            bpm_counts=channels.bpm_counts,
            corrector_counts=channels.corrector_counts,
            still=still_vectors(config.ring.load(), channels),
        )
        self._statistics = statistics
        self._child = ServerChild(job, "orbitfb.panel", "the panel")
        self._stop = threading.Event()
        self.where = f"{config.panel.interface}:{self._child.start()}"
        self.prefix = config.panel.prefix
        self._thread = threading.Thread(target=self._watch, name="panel-watch", daemon=True)
        self._thread.start()
        stack.callback(self._close)
        _log.info("panel_started", where=self.where, prefix=self.prefix)

    def _close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._child.stop()

    def _watch(self) -> None:
        pause = LOOK_PERIOD
        while not self._stop.wait(pause):
            if self._child.alive:
                pause = LOOK_PERIOD
                continue
            words = self._child.last_words() or "it said nothing"
            _log.error("panel_died", problem=words)
            self._statistics.happened("panel", f"died: {words}")
            try:
                self._child.start()
            except OrbitFeedbackError as error:
                pause = min(2 * pause, LONGEST_PAUSE)
                _log.error("panel_not_started", problem=str(error), again_after=pause)
            else:
                _log.info("panel_started", where=self.where, prefix=self.prefix)
