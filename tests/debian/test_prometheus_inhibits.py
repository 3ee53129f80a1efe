"""A real Alertmanager says which alerts silence which, with deploy/prometheus/alertmanager.yml."""

import json
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from control_room import running
from free_ports import free_port
from service_process import wait_for

CONFIG = Path(__file__).parents[2] / "deploy/prometheus/alertmanager.yml"
GONE = "OrbitHeartbeatGone"


class Alertmanager:
    """One that runs; each test has a job of its own."""

    def __init__(self, port: int) -> None:
        self._url = f"http://127.0.0.1:{port}/api/v2/alerts"

    def alerts(self) -> list[dict[str, Any]]:
        with urllib.request.urlopen(self._url, timeout=5) as answer:
            return json.load(answer)

    def send(self, job: str, alerts: dict[str, tuple[str, ...]]) -> None:
        """Send alerts by the instances that have them."""
        told = [
            {
                "labels": {"alertname": name, "job": job}
                | ({"instance": instance} if instance else {}),
                "annotations": {},
            }
            for name, instances in alerts.items()
            for instance in instances
        ]
        request = urllib.request.Request(
            self._url, json.dumps(told).encode(), {"Content-Type": "application/json"}
        )
        urllib.request.urlopen(request, timeout=5).close()

    def silenced(self, job: str) -> set[tuple[str, str]]:
        """Give (alert, instance) of what is not told."""
        return {
            (alert["labels"]["alertname"], alert["labels"].get("instance", ""))
            for alert in self.alerts()
            if alert["labels"]["job"] == job and alert["status"]["inhibitedBy"]
        }


@pytest.fixture(scope="module")
def alertmanager(
    tmp_path_factory: pytest.TempPathFactory, alertmanager_program: str
) -> Iterator[Alertmanager]:
    directory, port = tmp_path_factory.mktemp("inhibits"), free_port()
    command = (
        alertmanager_program,
        f"--config.file={CONFIG}",
        f"--storage.path={directory / 'data'}",
        f"--web.listen-address=127.0.0.1:{port}",
        "--cluster.listen-address=",
    )
    there = Alertmanager(port)

    def answers() -> bool:
        try:
            return there.alerts() == []
        except urllib.error.URLError:
            return False

    with running(directory, "alertmanager", *command):
        wait_for("Alertmanager", answers, 20.0)
        yield there


CASES = {
    "one-of-two-is-gone": (
        {GONE: ("a",), "OrbitTripped": ("b",), "OrbitArchiveNotWriting": ("a", "b")},
        {("OrbitArchiveNotWriting", "a")},
    ),
    "no-service-at-all": (
        {GONE: ("",), "OrbitRolledBack": ("a", "b")},
        {("OrbitRolledBack", "a"), ("OrbitRolledBack", "b")},
    ),
    "one-of-two-tripped": (
        {"OrbitTripped": ("a",), "OrbitNotClosed": ("a", "b"), "OrbitBpmsMasked": ("a",)},
        {("OrbitNotClosed", "a")},
    ),
}
"""What fires, and what of it is silenced."""


@pytest.mark.parametrize("job", CASES)
def test_an_alert_silences_those_of_its_service_alone(alertmanager: Alertmanager, job: str):
    fires, silenced = CASES[job]
    alertmanager.send(job, fires)
    # The source is known once it silences anything; then nothing else may be silenced.
    wait_for("silence", lambda: silenced <= alertmanager.silenced(job), 30.0)
    assert alertmanager.silenced(job) == silenced
