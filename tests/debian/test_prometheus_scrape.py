"""A real Prometheus scrapes a real run: everything that is asked has an answer."""

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from control_room import DEPLOY, Room, control_room
from ioc_clients import run_client
from service_process import orbitfb, wait_for

from deploy.grafana.generate import files
from orbitfb.observe.metrics.catalogue import METRICS
from orbitfb.sim.layout import STORED_PV

pytestmark = [
    pytest.mark.system,
    pytest.mark.timeout(360),
]  # a look at the gap: seconds, or a minute
SELECTOR = re.compile(r"\b(?:orbitfb[_:][a-z0-9_:]+|up(?=\{))(?:\{[^}]*\})?")


@pytest.fixture(scope="module")
def room(
    tmp_path_factory: pytest.TempPathFactory, prometheus_program: str, alertmanager_program: str
) -> Iterator[Room]:
    directory = tmp_path_factory.mktemp("room")
    with control_room(directory, prometheus_program, alertmanager_program) as there:
        yield there


def rules(name: str) -> list[dict[str, str]]:
    groups = yaml.safe_load((DEPLOY / name).read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def panel_expressions() -> set[str]:
    return {
        target["expr"].replace("$instance", ".*")
        for text in files().values()
        for panel in json.loads(text)["panels"]
        for target in panel.get("targets", ())
    }


def recorded_expressions() -> set[str]:
    return {rule["expr"] for rule in rules("orbitfb-rules.yml")}


def alert_selectors() -> set[str]:
    """What alerts look at: that it is there says that they could fire."""
    return {name for rule in rules("orbitfb-alerts.yml") for name in SELECTOR.findall(rule["expr"])}


def answered(room: Room, expressions: set[str], timeout: float) -> list[str]:
    """Give what stays without an answer."""
    deadline = time.monotonic() + timeout
    left = room.empty(expressions)
    while left and time.monotonic() < deadline:
        time.sleep(0.5)
        left = room.empty(set(left))
    return left


def test_every_expression_of_panels_and_rules_has_an_answer(room: Room):
    expressions = panel_expressions() | recorded_expressions() | alert_selectors()
    assert len(expressions) > 90
    assert answered(room, expressions, 60.0) == []
    assert room.empty({"orbitfb_tick_total"}) == ["orbitfb_tick_total"]


def test_what_is_scraped_is_what_is_documented(room: Room):
    names = {name for name in room.ask("label/__name__/values") if name.startswith("orbitfb_")}
    documented = {metric.name for metric in METRICS}
    suffixed = {
        f"{metric.name}{suffix}"
        for metric in METRICS
        if metric.kind in ("histogram", "summary")
        for suffix in ("_bucket", "_sum", "_count")
    }
    assert names <= documented | suffixed
    absent = documented - names - {m.name for m in METRICS if m.kind in ("histogram", "summary")}
    # Only what no alarm of the learner has caused yet.
    assert absent <= {"orbitfb_last_alarm_delay_ticks"}


def test_rules_are_healthy_and_no_text_of_an_alert_is_broken(room: Room):
    groups = room.ask("rules")["groups"]
    found = [rule for group in groups for rule in group["rules"]]
    assert len(found) == len(rules("orbitfb-rules.yml")) + len(rules("orbitfb-alerts.yml"))
    assert {rule["name"]: rule.get("lastError") for rule in found if rule["health"] == "err"} == {}


def test_figures_are_those_of_the_service(room: Room):
    (sample,) = room.samples("orbitfb_loop_closed_by_info")
    assert (sample["metric"]["user"], sample["metric"]["host"]) == ("start", "localhost")
    (code,) = room.samples("orbitfb:loop_state:code")
    assert code["value"][1] == "3"
    (tick,) = room.samples("orbitfb_ticks_total")
    assert 0 < float(tick["value"][1]) <= room.service.status()["ticks"]
    (gap,) = room.samples("orbitfb_gap_suspect_info")
    assert gap["metric"]["stage"] in ("actuator", "sensor", "optics")


def put_current(room: Room, milliamperes: float) -> None:
    run_client(
        room.service.port,
        f"""
        from caproto.sync.client import write
        write({STORED_PV!r}, [{milliamperes}], notify=True, repeater=False)
        print(1)
        """,
    )


def test_alertmanager_calls_somebody_when_the_loop_trips(room: Room):
    put_current(room, 0.0)
    room.service.wait_state("TRIPPED", 10.0)

    def called() -> dict[str, dict[str, str]] | None:
        alerts = room.webhook.alerts
        told = [one for one in alerts if one["labels"]["alertname"] == "OrbitTripped"]
        return told[0] if told else None

    alert = wait_for("call", called, 30.0)
    assert alert["status"] == "firing"
    assert alert["labels"]["severity"] == "critical" and "docs" not in alert["labels"]
    notes = alert["annotations"]
    assert notes["summary"] == "The orbit feedback is TRIPPED."
    assert "current" in notes["description"] and "error" not in notes["description"]
    page = notes["runbook_url"].removeprefix("http://127.0.0.1:8000/").replace(".html", ".md")
    assert (Path(__file__).parents[2] / "docs" / page).is_file()


def test_who_closes_it_again_is_shown(room: Room):
    put_current(room, 400.0)
    for command in ("reset", "close"):
        done = orbitfb("command", command, "--data", room.service.data)
        assert done.returncode == 0, done.stderr

    def closed_again() -> bool:
        (sample,) = room.samples("orbitfb_loop_closed_by_info == 1")[:1] or [{"metric": {}}]
        return sample["metric"].get("user") not in ("start", None)

    wait_for("name", closed_again, 10.0)
    (given,) = room.samples('orbitfb_commands_total{outcome="given"}')
    assert given["value"][1] == "2"
