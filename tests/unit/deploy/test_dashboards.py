"""The dashboards as Grafana reads them, without a Grafana."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from deploy.grafana.dashboard import Dashboard, dashboard_json
from deploy.grafana.generate import DASHBOARDS, TARGET, files
from deploy.grafana.loop import LATENCY_LIMIT, PERIOD_LIMIT
from deploy.grafana.panels import COLUMNS, INFORMATION, Panel, Query
from deploy.grafana.shift import RMS_LIMIT
from orbitfb.observe.metrics.catalogue import METRICS

ROOT = Path(__file__).parents[3]
RULES = ROOT / "deploy/prometheus/orbitfb-rules.yml"
ALERTS = ROOT / "deploy/prometheus/orbitfb-alerts.yml"
NAME = re.compile(r"\borbitfb(?:_[a-z0-9_]+|:[a-z0-9_:]+)")
SUFFIXES = ("_bucket", "_sum", "_count")


def loaded() -> list[dict[str, Any]]:
    return [json.loads(text) for text in files().values()]


def drawn(dashboard: dict[str, Any]) -> list[dict[str, Any]]:
    return [panel for panel in dashboard["panels"] if panel["type"] != "row"]


def rules(path: Path) -> list[dict[str, Any]]:
    return [rule for group in yaml.safe_load(path.read_text())["groups"] for rule in group["rules"]]


def unknown(expression: str) -> set[str]:
    """Give the names of an expression that are neither exported nor recorded."""
    exported = {metric.name for metric in METRICS}
    whole = exported | {rule["record"] for rule in rules(RULES)}
    whole |= {f"{metric.name}{suffix}" for metric in METRICS for suffix in SUFFIXES}
    return set(NAME.findall(expression)) - whole


def test_the_files_are_those_of_the_generator():
    there = {path.name: path.read_text(encoding="utf-8") for path in TARGET.glob("*.json")}
    assert there == files(), "run: python -m deploy.grafana.generate"


def test_uids_and_ids_are_unique():
    dashboards = loaded()
    assert len({one["uid"] for one in dashboards}) == len(DASHBOARDS) == 4
    assert len({one["title"] for one in dashboards}) == 4
    for one in dashboards:
        numbers = [panel["id"] for panel in one["panels"]]
        assert len(set(numbers)) == len(numbers)
        for panel in drawn(one):
            letters = [target["refId"] for target in panel["targets"]]
            assert len(set(letters)) == len(letters)


def test_no_panel_overlaps_another_or_leaves_the_grid():
    for one in loaded():
        taken: dict[tuple[int, int], str] = {}
        for panel in one["panels"]:
            place = panel["gridPos"]
            assert place["x"] + place["w"] <= COLUMNS
            for x in range(place["x"], place["x"] + place["w"]):
                for y in range(place["y"], place["y"] + place["h"]):
                    assert taken.setdefault((x, y), panel["title"]) is panel["title"]


def test_every_panel_has_unit_description_thresholds_and_the_variable_datasource():
    for one in loaded():
        names = [variable["name"] for variable in one["templating"]["list"]]
        assert names == ["datasource", "instance"]
        for panel in drawn(one):
            defaults = panel["fieldConfig"]["defaults"]
            assert panel["title"] and panel["description"].endswith("."), panel["title"]
            assert defaults["unit"], panel["title"]
            steps = defaults["thresholds"]["steps"]
            values = [step["value"] for step in steps]
            assert values[0] is None and values[1:] == sorted(values[1:]), panel["title"]
            assert panel["datasource"]["uid"] == "${datasource}"
            for target in panel["targets"]:
                assert target["datasource"] == panel["datasource"]
                assert "$instance" in target["expr"]


def test_no_dashboard_or_rule_asks_for_what_is_not_exported():
    asked = [
        (panel["title"], target["expr"])
        for one in loaded()
        for panel in drawn(one)
        for target in panel["targets"]
    ]
    asked += [
        (rule.get("record", rule.get("alert")), rule["expr"] + str(rule.get("annotations", "")))
        for path in (RULES, ALERTS)
        for rule in rules(path)
    ]
    asked += [
        ("annotation", note["expr"]) for one in loaded() for note in one["annotations"]["list"]
    ]
    assert len(asked) > 90
    assert {name: missing for name, text in asked if (missing := unknown(text))} == {}
    assert unknown("rate(orbitfb_tick_total[5m])") == {"orbitfb_tick_total"}


def test_every_metric_but_a_few_is_on_a_dashboard_or_in_a_rule():
    text = json.dumps(loaded()) + RULES.read_text() + ALERTS.read_text()
    shown = set(NAME.findall(text)) | {
        name.removesuffix(suffix) for name in NAME.findall(text) for suffix in SUFFIXES
    }
    assert {metric.name for metric in METRICS} - shown == {
        "orbitfb_bpms",
        "orbitfb_corrector_limit_amperes",
        "orbitfb_corrector_setpoint_max_amperes",
        "orbitfb_last_alarm_delay_ticks",
        "orbitfb_orbit_error_max_meters",
        "orbitfb_orbit_rms_meters",
        "orbitfb_rf_frequency_hertz",
        "orbitfb_true_orbit_rms_meters",
    }


def test_a_panel_that_is_too_wide_is_refused():
    panel = Panel("stat", "x", "x.", "s", (Query("up"),), COLUMNS + 1, INFORMATION)
    with pytest.raises(ValueError, match="wider"):
        dashboard_json(Dashboard("x", "x", "x", (("x", (panel,)),)))


def test_every_alert_has_meaning_first_action_and_a_runbook_of_its_own():
    alerts = rules(ALERTS)
    pages = set()
    for alert in alerts:
        notes = alert["annotations"]
        assert set(notes) == {"summary", "description", "action", "runbook_url"}
        assert alert["labels"]["severity"] in ("info", "warning", "critical")
        page = re.fullmatch(
            r"\{\{ \$externalLabels\.docs \}\}/runbooks/([a-z-]+)\.html", notes["runbook_url"]
        )
        assert page is not None
        text = (ROOT / f"docs/runbooks/{page[1]}.md").read_text(encoding="utf-8")
        assert text.startswith(f"# {alert['alert']}\n")
        for heading in ("## What it means", "## First", "## Then", "## When it is over"):
            assert f"\n{heading}\n" in text, (page[1], heading)
        pages.add(f"{page[1]}.md")
    assert len(pages) == len(alerts) == 12
    there = {path.name for path in (ROOT / "docs/runbooks").glob("*.md")}
    assert there - {"index.md"} == pages


def test_every_query_of_an_alert_s_text_asks_for_its_own_service():
    queries = 0
    for alert in rules(ALERTS):
        text = " ".join(alert["annotations"].values())
        own = re.findall(
            r"""printf "\w+\{job='%s', instance='%s'[^"]*" """
            r"""\$labels\.job \$labels\.instance \| query""",
            text,
        )
        assert len(own) == len(re.findall(r"\bquery\b", text)), alert["alert"]
        queries += len(own)
    assert queries == 7


def test_colours_and_lines_of_the_panels_are_those_of_the_alerts():
    limits = {alert["alert"]: alert["expr"] for alert in rules(ALERTS)}
    assert f'noise_ratio{{job="orbitfb"}} > {RMS_LIMIT} ' in limits["OrbitRmsHigh"] + " "
    late = limits["OrbitTickLate"]
    for limit in (PERIOD_LIMIT, LATENCY_LIMIT):
        assert f"> {limit} * orbitfb_tick_period_nominal_seconds" in late
    panels = {(one["uid"], panel["title"]): panel for one in loaded() for panel in drawn(one)}
    for title in ("Orbit RMS", "Orbit RMS over the noise floor", "Worst BPMs"):
        panel = panels["orbitfb-shift", title]
        assert "noise_ratio" in panel["targets"][0]["expr"]
        assert panel["fieldConfig"]["defaults"]["thresholds"]["steps"][-1]["value"] == RMS_LIMIT


def test_no_colour_judges_a_length_or_a_time():
    """Noise and rate differ from ring to ring: only ratios to them are good or bad."""
    for one in loaded():
        for panel in drawn(one):
            defaults = panel["fieldConfig"]["defaults"]
            if one["uid"] in ("orbitfb-shift", "orbitfb-loop") and defaults["unit"] in (
                "lengthm",
                "s",
                "hertz",
            ):
                assert len(defaults["thresholds"]["steps"]) == 1, panel["title"]


def test_windows_hold_two_samples_of_the_longest_scrape_interval():
    expressions = [rule["expr"] for path in (RULES, ALERTS) for rule in rules(path)]
    expressions += [
        target["expr"] for one in loaded() for p in drawn(one) for target in p["targets"]
    ]
    expressions += [note["expr"] for one in loaded() for note in one["annotations"]["list"]]
    windows = {window for text in expressions for window in re.findall(r"\[(\w+)\]", text)}
    seconds = {
        window: int(window[:-1]) * {"s": 1, "m": 60, "d": 86400}[window[-1]] for window in windows
    }
    assert min(seconds.values()) == 120, seconds


def test_provisioning_leads_to_the_dashboards():
    provisioning = ROOT / "deploy/grafana/provisioning"
    (source,) = yaml.safe_load((provisioning / "datasources/prometheus.yaml").read_text())[
        "datasources"
    ]
    assert source["type"] == "prometheus" and source["url"] == "http://127.0.0.1:9090"
    (provider,) = yaml.safe_load((provisioning / "dashboards/orbitfb.yaml").read_text())[
        "providers"
    ]
    compose = yaml.safe_load((ROOT / "deploy/compose.yaml").read_text())
    mounts = compose["services"]["grafana"]["volumes"]
    assert f"./grafana/dashboards:{provider['options']['path']}:ro" in mounts


def test_the_screens_and_the_service_agree_on_the_port():
    config = yaml.safe_load((ROOT / "deploy/prometheus/prometheus.yml").read_text())
    (scrape,) = config["scrape_configs"]
    assert scrape["static_configs"] == [{"targets": ["127.0.0.1:9180"]}]
    assert config["rule_files"] == [RULES.name, ALERTS.name]
