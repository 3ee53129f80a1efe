"""The simulated ring of the service's own: started with it, watched, and stopped with it."""

import threading
from collections.abc import Callable
from contextlib import ExitStack

import structlog

from orbitfb.config.tree import AppConfig
from orbitfb.epics.settings import PVA_SEARCH_PORT, AuxiliarySettings, EpicsSettings, PvaSettings
from orbitfb.observe.statistics.running import TRUE_RMS
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import TRUE_RMS_PV

_log = structlog.stdlib.get_logger("orbitfb.service")

CHILD_PERIOD = 0.5
"""How often to look whether the simulated ring of our own is alive [s]."""


class SimulatedRing:
    """Serves a simulated ring from a child process.

    Args:
        job: What to serve.
        stack: Stops it.

    Attributes:
        failure: Why it died; empty while it lives.
    """

    def __init__(self, job: SimJob, stack: ExitStack) -> None:
        self.failure = ""
        for its in job.effects:
            _log.info(
                "effect_simulated",
                effect=its.id,
                values=its.filled,
                devices="+".join(its.names or its.cells) or "all",
                planes=its.planes,
                since=its.since,
            )
        self._child = SimChild(job)
        self._port = self._child.start()
        stack.callback(self._child.stop)

    def settings(self, config: AppConfig) -> EpicsSettings:
        """Say how to reach it.

        Args:
            config: Of the service.
        """
        true_rms = AuxiliarySettings(pv=TRUE_RMS_PV, scale=1e-3)
        return config.epics.model_copy(
            update={
                "address_list": config.sim.interface,
                "name_servers": "",
                "auto_address_list": False,
                "server_port": self._port,
                "pva": PvaSettings(port=self._child.pva_port or PVA_SEARCH_PORT),
                "auxiliary": {**config.epics.auxiliary, TRUE_RMS: true_rms},
            }
        )

    def watch(self, stop: threading.Event, died: Callable[[str], None]) -> None:
        """Say it when the ring has died; the loop holds until one is back.

        Args:
            stop: Ends the watch.
            died: Told why.
        """
        while not stop.wait(CHILD_PERIOD):
            if not self._child.alive:
                words = self._child.last_words() or "it said nothing"
                self.failure = (
                    f"the simulated ring (process {self._child.pid}) died: {words}; "
                    f"`orbitfb ioc --port {self._child.port}` brings one back"
                )
                _log.error("simulated_ring_died", problem=self.failure)
                died(self.failure)
                return
