"""A service, a Prometheus that scrapes it, an Alertmanager, and somebody whom that one calls."""

import json
import shutil
import subprocess
import sys
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import yaml
from free_ports import free_port

sys.path.append(str(Path(__file__).parents[1] / "system"))
from service_process import Service, wait_for

DEPLOY = Path(__file__).parents[2] / "deploy/prometheus"
CONFIG = """
[loop]
rate_hz = 10.0
hold_after = 50.0  # a computer that is busy with other tests is no trouble of the ring
[dither]
orbit_cost = 3e-6
[learn]
every = 50
[diagnose.live]
period = 3.0
window = 260
"""
EFFECT = "corrector-gain:gain=0.5,names=CH1A_C10"
DIAGNOSIS = {
    "gap": {"nats_per_tick": 9.3},
    "shrink": {"nats": 0.99, "low": 0.9, "high": 1.0},
}


class Webhook:
    """Takes what Alertmanager sends."""

    def __init__(self) -> None:
        self.alerts: list[dict[str, Any]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.alerts += json.loads(body)["alerts"]
                self.send_response(200)
                self.end_headers()

            def log_message(self, format: str, *args: object) -> None:
                """Say nothing."""

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.port = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,))
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@contextmanager
def running(directory: Path, name: str, *command: object) -> Iterator[None]:
    """Run a program of Debian; it is ended and waited for."""
    with (directory / f"{name}.log").open("w") as log:
        process = subprocess.Popen(
            [str(word) for word in command], stdout=log, stderr=log, cwd=directory
        )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Room:
    """What the tests ask.

    Args:
        service: The feedback.
        prometheus: Port of Prometheus.
        webhook: Whom Alertmanager calls.
    """

    def __init__(self, service: Service, prometheus: int, webhook: Webhook) -> None:
        self.service, self.webhook = service, webhook
        self._root = f"http://127.0.0.1:{prometheus}/api/v1"

    def ask(self, what: str, **parameters: str) -> Any:
        """Ask Prometheus' API."""
        query = urllib.parse.urlencode(parameters)
        with urllib.request.urlopen(f"{self._root}/{what}?{query}", timeout=10) as answer:
            return json.load(answer)["data"]

    def samples(self, expression: str) -> list[dict[str, Any]]:
        """Evaluate an expression now."""
        return self.ask("query", query=expression)["result"]

    def empty(self, expressions: set[str]) -> list[str]:
        """Give the expressions that have no answer now."""
        return sorted(one for one in expressions if not self.samples(one))


def configured(name: str, directory: Path, *replaced: tuple[str, str]) -> Path:
    """Copy a configuration with other ports."""
    text = (DEPLOY / name).read_text()
    for before, after in replaced:
        assert before in text
        text = text.replace(before, after)
    yaml.safe_load(text)
    path = directory / name
    path.write_text(text)
    return path


@contextmanager
def control_room(directory: Path, prometheus: str, alertmanager: str) -> Iterator[Room]:
    """Start everything, on free ports of loopback; nothing is left behind."""
    for name in ("orbitfb-rules.yml", "orbitfb-alerts.yml"):
        shutil.copy(DEPLOY / name, directory)
    data = directory / "data"
    (data / "archive.diagnosis").mkdir(parents=True)
    (data / "archive.diagnosis/diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    (directory / "c.toml").write_text(CONFIG)
    with ExitStack() as stack:
        webhook = Webhook()
        stack.callback(webhook.close)
        options = ("--config", directory / "c.toml", "--effect", EFFECT)
        service = stack.enter_context(Service(data, "sim", *options, watch=True))
        target = service.where["metrics"].removeprefix("http://")
        ports = free_port(), free_port()
        callee = configured(
            "alertmanager.yml", directory, ("127.0.0.1:9095", f"127.0.0.1:{webhook.port}")
        )
        config = configured(
            "prometheus.yml",
            directory,
            ("127.0.0.1:9180", target),
            ("127.0.0.1:9093", f"127.0.0.1:{ports[1]}"),
            ("_interval: 5s", "_interval: 1s"),
        )
        stack.enter_context(
            running(
                directory,
                "alertmanager",
                alertmanager,
                f"--config.file={callee}",
                f"--storage.path={directory / 'alertmanager'}",
                f"--web.listen-address=127.0.0.1:{ports[1]}",
                "--cluster.listen-address=",
            )
        )
        stack.enter_context(
            running(
                directory,
                "prometheus",
                prometheus,
                f"--config.file={config}",
                f"--storage.tsdb.path={directory / 'prometheus'}",
                f"--web.listen-address=127.0.0.1:{ports[0]}",
            )
        )
        room = Room(service, ports[0], webhook)
        # Learner and watch have processes of their own: after that nothing more is started.
        for first in ("orbitfb_last_refit_rows", "orbitfb_gap_suspect_info"):
            wait_for(first, lambda name=first: _scraped(room, name), 240.0)
        yield room


def _scraped(room: Room, name: str) -> bool:
    time.sleep(0.2)
    room.service.check_alive()
    try:
        return bool(room.samples(name))
    except OSError:
        return False
