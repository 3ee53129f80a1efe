"""HTTP endpoints: /metrics for Prometheus, /healthz and /readyz for probes. Read-only."""

import errno
import threading
from collections.abc import Callable
from http import HTTPStatus

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder

from orbitfb.core.errors import OwnershipError
from orbitfb.observe.bounded_http import TEXT, Answer, BoundedServer
from orbitfb.observe.health import Verdict, health, readiness
from orbitfb.observe.plain import dumps
from orbitfb.observe.settings import ObserveSettings
from orbitfb.observe.snapshot import LoopSnapshot

INDEX = (
    "orbitfb\n\n/metrics   figures for Prometheus\n/healthz   is it alive\n/readyz    is it ready\n"
)

JSON = "application/json"


class ObserveServer:
    """Serve metrics and health from daemon threads.

    Args:
        settings: Address, port, when the loop counts as stale.
        registry: What `/metrics` exposes.
        snapshot: Returns the figures of this moment.
    """

    def __init__(
        self,
        settings: ObserveSettings,
        registry: CollectorRegistry,
        snapshot: Callable[[], LoopSnapshot],
    ) -> None:
        self._settings = settings
        self._registry = registry
        self._snapshot = snapshot
        self._server: BoundedServer | None = None
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> str:
        """URL of the root, `http://127.0.0.1:9180`; empty while nothing is served."""
        if self._server is None:
            return ""
        host, port = self._server.server_address[:2]
        return f"http://[{host!s}]:{port}" if ":" in str(host) else f"http://{host!s}:{port}"

    def start(self) -> None:
        """Begin to serve; nothing happens when the settings say so.

        Raises:
            OwnershipError: The port is in use, or the address is not of this computer.
        """
        if not self._settings.enabled or self._server is not None:
            return
        where = (self._settings.host, self._settings.port)
        try:
            self._server = BoundedServer(where, self._answer)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                cause = "is in use: is another orbitfb running?"
            else:
                cause = f"cannot be listened on ({error.strerror})."
            raise OwnershipError(
                f"metrics and health: {where[0]} port {where[1]} {cause} "
                "Set observe.host and observe.port (0 takes any free port), "
                "or observe.enabled = false"
            ) from error
        self._thread = threading.Thread(
            target=self._server.serve_forever,
            kwargs={"poll_interval": 0.1},
            name="orbitfb-http",
            daemon=True,
        )
        self._thread.start()

    def stop(self) -> None:
        """Stop serving, put out who is connected and free the port. May be called twice."""
        server, thread = self._server, self._thread
        self._server = self._thread = None
        if server is None or thread is None:
            return
        server.shutdown()
        thread.join()
        server.server_close()

    def _answer(self, path: str, accept: str) -> Answer:
        """Return status, content type and body for a path."""
        if path == "/metrics":
            encode, content_type = choose_encoder(accept)
            return HTTPStatus.OK, content_type, encode(self._registry)
        if path == "/healthz":
            return _probe(health(self._snapshot(), self._settings.stale_after))
        if path == "/readyz":
            return _probe(readiness(self._snapshot(), self._settings.stale_after))
        if path == "/":
            return HTTPStatus.OK, TEXT, INDEX.encode()
        return HTTPStatus.NOT_FOUND, TEXT, b"not found\n"


def _probe(verdict: Verdict) -> Answer:
    status = HTTPStatus.OK if verdict.good else HTTPStatus.SERVICE_UNAVAILABLE
    return status, JSON, (dumps(verdict.body) + "\n").encode()
