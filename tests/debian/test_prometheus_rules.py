"""Every rule and every alert under promtool: firing, and not firing when it comes near."""

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from alert_cases import ALSO_FIRES, CASES, OWN, Series, state

from deploy.grafana.generate import files

DEPLOY = Path(__file__).parents[2] / "deploy/prometheus"
RULES = [str(DEPLOY / name) for name in ("orbitfb-rules.yml", "orbitfb-alerts.yml")]


def owned(selector: str) -> str:
    """Give a series the labels that Prometheus gives what it scrapes."""
    name, _, labels = selector.removesuffix("}").partition("{")
    return f"{name}{{{labels + ', ' if labels else ''}{OWN}}}"


def group(what: str, alert: str, series: Series, at: str, firing: int) -> dict[str, Any]:
    return {
        "name": what,
        "interval": "10s",
        "external_labels": {"docs": "http://docs"},
        "input_series": [
            {"series": owned(name), "values": values} for name, values in series.items()
        ],
        "promql_expr_test": [
            {
                "expr": f'count(ALERTS{{alertname="{alert}", alertstate="firing"}}) or vector(0)',
                "eval_time": at,
                "exp_samples": [{"labels": "{}", "value": firing}],
            }
        ],
    }


def groups() -> Iterator[dict[str, Any]]:
    for alert, case in CASES.items():
        yield group(f"{alert} fires", alert, case.fires, case.at, 1)
        for number, series in enumerate(case.quiet):
            yield group(f"{alert} is quiet {number}", alert, series, case.at, 0)
    for number, (alert, series) in enumerate(ALSO_FIRES):
        yield group(f"{alert} also fires {number}", alert, series, CASES[alert].at, 1)


def promtool(promtool_program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [promtool_program, *arguments], capture_output=True, text=True, timeout=60, check=False
    )


def run_groups(program: str, directory: Path, tests: list[dict[str, Any]]) -> str:
    """Run promtool on tests; return what it has to object, nothing if all is well."""
    file = directory / "tests.yml"
    content = {"rule_files": RULES, "evaluation_interval": "10s", "tests": tests}
    file.write_text(yaml.safe_dump(content, allow_unicode=True))
    done = promtool(program, "test", "rules", str(file))
    return "" if done.returncode == 0 else done.stdout + done.stderr


def test_config_and_rules_are_valid(promtool_program: str):
    done = promtool(promtool_program, "check", "config", str(DEPLOY / "prometheus.yml"))
    assert done.returncode == 0, done.stderr
    assert "SUCCESS: 2 rule files found" in done.stdout
    done = promtool(promtool_program, "check", "rules", *RULES)
    assert done.returncode == 0, done.stderr


def test_every_alert_has_cases():
    alerts = yaml.safe_load(Path(RULES[1]).read_text())["groups"][0]["rules"]
    assert {alert["alert"] for alert in alerts} == set(CASES)


def test_every_alert_fires_and_is_quiet_when_it_comes_near(promtool_program: str, tmp_path: Path):
    tests = list(groups())
    assert len(tests) > 30
    assert run_groups(promtool_program, tmp_path, tests) == ""


def test_an_alert_says_what_it_knows(promtool_program: str, tmp_path: Path):
    tests = []
    for alert, case in CASES.items():
        test = group(alert, alert, case.fires, case.at, 1)
        # None is expected, so that promtool tells what it got.
        test["alert_rule_test"] = [{"alertname": alert, "eval_time": case.at, "exp_alerts": []}]
        tests.append(test)
    told = " ".join(run_groups(promtool_program, tmp_path, tests).split())
    assert {alert: case.says for alert, case in CASES.items() if case.says not in told} == {}
    assert "error" not in told
    assert told.count("http://docs/runbooks/") == len(CASES)


def foreign(selector: str, own: str) -> str:
    """Give the same series of a service that is not asked about, with other words."""
    words = re.sub(r'(reason|places|effect|stage)="[^"]*"', r'\1="foreign"', owned(selector))
    return words.replace(OWN, own)


def test_an_alert_says_nothing_of_another_service(promtool_program: str, tmp_path: Path):
    tests = []
    asked = ("_info", "_limit", "_probability")
    for alert, case in CASES.items():
        test = group(alert, alert, case.fires, case.at, 1)
        for own in ('job="orbitfb", instance="another"', 'job="another", instance="ring"'):
            said = {
                name: "77x120"
                for name in case.fires
                if name.partition("{")[0].removesuffix("}").endswith(asked)
            }
            said |= (
                state("FAULT")
                if alert == "OrbitNotClosed" and own.startswith('job="another"')
                else {}
            )
            test["input_series"] += [
                {"series": foreign(name, own), "values": values} for name, values in said.items()
            ]
        test["alert_rule_test"] = [{"alertname": alert, "eval_time": case.at, "exp_alerts": []}]
        tests.append(test)
    told = " ".join(run_groups(promtool_program, tmp_path, tests).split())
    assert {alert: case.says for alert, case in CASES.items() if case.says not in told} == {}
    assert "foreign" not in told and "77" not in told and "It is FAULT" not in told


def test_the_panel_counts_the_alerts_of_its_service(promtool_program: str, tmp_path: Path):
    panels = json.loads(files()["shift.json"])["panels"]
    (panel,) = [panel for panel in panels if panel["title"] == "Alerts"]
    expression = panel["targets"][0]["expr"]
    test = group("alerts", "OrbitBpmsMasked", {"orbitfb_bpms_invalid": "3x60"}, "5m", 1)
    test["input_series"].append({"series": f"up{{{OWN}}}", "values": "1x60"})
    gone = group("gone", "OrbitHeartbeatGone", {"something_else": "1x60"}, "5m", 1)
    for one, instance, count in ((test, "ring", 1), (test, "another", 0), (gone, "ring", 1)):
        one["promql_expr_test"].append(
            {
                "expr": expression.replace("$instance", instance),
                "eval_time": "5m",
                "exp_samples": [{"labels": "{}", "value": count}],
            }
        )
    assert run_groups(promtool_program, tmp_path, [test, gone]) == ""


def test_a_wrong_expectation_is_seen(promtool_program: str, tmp_path: Path):
    case = CASES["OrbitTripped"]
    wrong = group("wrong", "OrbitTripped", case.fires, case.at, 0)
    assert "FAILED" in run_groups(promtool_program, tmp_path, [wrong])
