"""HTTP endpoints: /metrics for Prometheus, /healthz and /readyz for probes. Read-only."""

import errno
import threading
from collections.abc import Callable, Sequence
from http import HTTPStatus

import structlog
from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

from orbitfb.core.host_names import HostNames
from orbitfb.observe.bounded_http import TEXT, Answer, BoundedServer
from orbitfb.observe.health import Verdict, health, readiness
from orbitfb.observe.plain import dumps
from orbitfb.observe.settings import ObserveSettings
from orbitfb.observe.statistics.snapshot import LoopSnapshot

INDEX = (
    "orbitfb\n\n/metrics   figures for Prometheus\n/healthz   is it alive\n/readyz    is it ready\n"
)

JSON = "application/json"

AGAIN_AFTER = 5.0
"""Time between two tries to listen where somebody else does [s]."""

_log = structlog.stdlib.get_logger("orbitfb.observe")


class ObserveServer:
    """Serve metrics and health from daemon threads.

    A port in use does not keep the loop from running: the port is tried again and again.

    Args:
        settings: Address, port, when the loop counts as stale.
        registry: What `/metrics` exposes.
        snapshot: Returns the figures of this moment.
        troubles: Returns what does not work now though the loop does, a sentence each.

    Attributes:
        problem: Why nothing is served; empty while it is, or should not be.
    """

    def __init__(
        self,
        settings: ObserveSettings,
        registry: CollectorRegistry,
        snapshot: Callable[[], LoopSnapshot],
        troubles: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        self._settings = settings
        self._registry = registry
        self._snapshot = snapshot
        self._troubles = troubles
        self._server: BoundedServer | None = None
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()
        self.problem = ""

    @property
    def address(self) -> str:
        """URL of the root, `http://127.0.0.1:9180`; empty while nothing is served."""
        if self._server is None:
            return ""
        host, port = self._server.server_address[:2]
        return f"http://[{host!s}]:{port}" if ":" in str(host) else f"http://{host!s}:{port}"

    def start(self) -> None:
        """Begin to serve, as soon as the port is free; not at all when the settings say so."""
        if not self._settings.enabled or self._thread is not None:
            return
        self._ended.clear()
        self._listen()
        if self.problem:
            _log.warning("metrics_not_served", problem=self.problem, again_after=AGAIN_AFTER)
        self._thread = threading.Thread(target=self._serve, name="orbitfb-http", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop serving, put out who is connected and free the port. May be called twice."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._ended.set()
        thread.join()
        server, self._server = self._server, None
        if server is not None:
            server.server_close()

    def _listen(self) -> None:
        """Try to have the port."""
        settings = self._settings
        names = HostNames(settings.host, settings.names)
        try:
            self._server = BoundedServer((settings.host, settings.port), self._answer, names)
            self.problem = ""
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                cause = "is in use: is another orbitfb running?"
            else:
                cause = f"cannot be listened on ({error.strerror})."
            self.problem = (
                f"metrics and health: {settings.host} port {settings.port} {cause} Set "
                "observe.host and observe.port (--metrics-port; 0 takes any free one), or "
                "observe.enabled = false"
            )

    def _serve(self) -> None:
        while self._server is None and not self._ended.wait(AGAIN_AFTER):
            self._listen()
            if self._server is not None:
                _log.info("metrics_served", where=self.address)
        while self._server is not None and not self._ended.is_set():
            self._server.handle_request()

    def _answer(self, path: str, accept: str) -> Answer:
        """Return status, content type and body for a path."""
        if path == "/metrics":
            encode, content_type = choose_encoder(accept)
            return HTTPStatus.OK, content_type, encode(self._registry)
        if path == "/healthz":
            return _probe(health(self._snapshot(), self._settings.stale_after, self._troubles()))
        if path == "/readyz":
            return _probe(readiness(self._snapshot(), self._settings.stale_after))
        if path == "/":
            return HTTPStatus.OK, TEXT, INDEX.encode()
        return HTTPStatus.NOT_FOUND, TEXT, b"not found\n"


def _probe(verdict: Verdict) -> Answer:
    status = HTTPStatus.OK if verdict.good else HTTPStatus.SERVICE_UNAVAILABLE
    return status, JSON, (dumps(verdict.body) + "\n").encode()
