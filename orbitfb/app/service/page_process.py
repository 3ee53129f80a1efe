"""The operator page of the service's own: started with it, watched, started again, stopped with it.

The loop runs with or without it: what keeps the page from being served is told, never raised.
"""

import ipaddress
import threading
from contextlib import ExitStack
from importlib.util import find_spec

import structlog

from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.signals import Channels
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.page.job import PageJob, PageLayout
from orbitfb.sim.child import ServerChild

_log = structlog.stdlib.get_logger("orbitfb.service")

NEEDED = ("starlette", "uvicorn", "websockets")
"""What the extra `web` brings."""
ADVICE = "install it with `pip install 'orbitfb[web]'`, or set web.enabled = false"
LOOK_PERIOD = 0.5
"""How often to look whether it is alive [s]."""
LONGEST_PAUSE = 60.0
"""Longest time between two attempts to start it [s]."""


class PageProcess:
    """Serves the page from a child process: the loop never waits for a viewer.

    Args:
        config: Of the service.
        channels: Of the loop.
        statistics: Told when it died.
        stack: Stops it.

    Attributes:
        where: Its address; empty while it is not served.
        problem: Why it is not served; empty when it is, or is not wanted.
    """

    def __init__(
        self,
        config: AppConfig,
        channels: Channels,
        statistics: LoopStatistics,
        stack: ExitStack,
    ) -> None:
        self.where, self.problem = "", ""
        if not config.web.enabled:
            return
        missing = [name for name in NEEDED if find_spec(name) is None]
        if missing:
            self.problem = f"the extra `web` is not installed ({', '.join(missing)}); {ADVICE}"
            _log.warning("page_not_started", problem=self.problem)
            return
        layout = PageLayout.of(
            config.ring.load(), channels, config.limits.setpoint, config.loop.period
        )
        directory = config.data_directory.resolve()
        job = PageJob(data_directory=directory, web=config.web, layout=layout)
        self._statistics, self._host = statistics, config.web.host
        self._child = ServerChild(job, "orbitfb.page", "its server")
        self._stop = threading.Event()
        self._start()
        self._thread = threading.Thread(target=self._watch, name="page-watch", daemon=True)
        self._thread.start()
        stack.callback(self._close)

    def _start(self) -> bool:
        try:
            port = self._child.start()
        except OrbitFeedbackError as error:
            self.where, self.problem = "", str(error)
            _log.warning("page_not_started", problem=self.problem)
            return False
        self.where, self.problem = _address(self._host, port), ""
        _log.info("page_started", where=self.where)
        return True

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
            if self.where:
                self.where, words = "", self._child.last_words() or "it said nothing"
                _log.error("page_died", problem=words)
                self._statistics.happened("page", f"died: {words}")
            pause = LOOK_PERIOD if self._start() else min(2 * pause, LONGEST_PAUSE)


def _address(host: str, port: int) -> str:
    """Give an address that a browser on this computer can use."""
    try:
        number = ipaddress.ip_address(host)
    except ValueError:
        return f"http://{host}:{port}/"
    shown = ("[::1]" if number.version == 6 else "127.0.0.1") if number.is_unspecified else host
    return (
        f"http://[{host}]:{port}/" if shown == host and ":" in host else f"http://{shown}:{port}/"
    )
