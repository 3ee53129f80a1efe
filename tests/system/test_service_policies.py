"""Refits on demand and the store, with a service and without; one story, in order."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from service_process import START, Service, orbitfb, transitions, wait_for

from orbitfb.control import client
from orbitfb.core.transitions import Transitions

pytestmark = pytest.mark.system

RATE_HZ = 50.0
FIGURES = {
    "response_moved",
    "response_uncertainty",
    "predicted_rms_candidate",
    "predicted_rms_incumbent",
    "reading_noise",
}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A loop whose ring has drifted far, and whose learner waits to be asked."""
    directory = tmp_path_factory.mktemp("policies")
    config = directory / "orbitfb.toml"
    patient = "[loop]\nhold_after = 100.0\n[epics]\nstale_after = 10.0\n"  # a busy computer stalls
    # with the response of before the drift, which the interlocks would notice at last
    patient += "[interlocks]\ndivergence_ticks = 100000\nprediction_ticks = 0\n"
    patient += "answer_reach = false\n"
    asked = "[learn]\nevery = 1000000\nfollow_drift = false\nchi2_trigger = 1e9\n"
    asked += "[learn.changes]\nminimum_sensitivity = 1e9\n"
    config.write_text(asked + patient)
    options = ("--rate", RATE_HZ, "--drift", "strong", "--drift-ticks", 100, "--config", config)
    with Service(directory / "data", "sim", *options, learn=True) as running:
        running.wait_status("ticks", lambda status: status["ticks"] > 400, 2 * START)
        client.ask(running.data, {"command": "open"})  # else the orbit leaves while we wait
        yield running


def ask(service: Service, *arguments: object) -> str:
    done = orbitfb(*arguments, "--data", service.data)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def listed(service: Service) -> dict[str, dict[str, Any]]:
    rows = json.loads(ask(service, "policies", "list", "--json"))
    return {row["id"]: row for row in rows}


def active(service: Service) -> str:
    [row] = [row for row in listed(service).values() if row["active"]]
    return row["id"]


def test_refit_keeps_what_the_judge_accepts_and_activates_nothing(service: Service):
    baseline = service.where["policy"]
    text = ask(service, "refit")
    assert re.search(r"^trigger +on-demand$", text, re.MULTILINE)
    assert re.search(
        r"^reason +expected beam motion \S+ µm rms, with the running policy \S+ µm rms"
        r"( \(and \S+ µm rms that the correctors cannot reach\))?: .*$",
        text,
        re.MULTILINE,
    )
    assert re.search(rf"^incumbent_id +{baseline}$", text, re.MULTILINE)
    for name in FIGURES:
        assert re.search(rf"^  {name} +[-+.\de]+( µm)?$", text, re.MULTILINE)
    [decision] = re.findall(r"^decision +(\S+)$", text, re.MULTILINE)
    [candidate] = re.findall(r"^policy_id +(\S+)$", text, re.MULTILINE)
    kept = {"accepted": {baseline, candidate}, "refused": {baseline}}
    assert set(listed(service)) == kept[decision]
    assert active(service) == baseline
    status = service.status()
    assert (status["policy"], status["swaps"], status["refits"]) == (baseline, 0, 1)


def test_refit_with_activate_swaps_the_policy(service: Service):
    baseline = service.where["policy"]
    client.ask(service.data, {"command": "close"})  # a candidate is looked at on closed ticks
    service.wait_below(20.0)  # and on none at which even the step towards the reference is limited
    report = json.loads(ask(service, "refit", "--activate", "--json"))
    assert report["decision"] == "promoted", report["reason"]
    candidate = report["policy_id"]
    service.wait_status("swap", lambda status: status["policy"] == candidate, START)
    assert service.status()["swaps"] == 1
    assert active(service) == candidate
    card = json.loads(ask(service, "policies", "show", candidate))
    assert (card["id"], card["parent"]) == (candidate, baseline)
    assert card["figures"] == report["figures"]
    [event] = service.events("refit_judged")[1:]
    assert (event["decision"], event["candidate"]) == ("promoted", candidate)


def test_rollback_reaches_the_running_loop(service: Service):
    baseline, left = service.where["policy"], active(service)
    assert ask(service, "policies", "rollback").split() == ["policy", baseline, "before", left]
    service.wait_status("swap", lambda status: status["policy"] == baseline, START)
    assert active(service) == baseline
    assert service.metric(f'orbitfb_policy_info{{policy="{baseline}"}}') == 1.0


def test_there_is_nothing_before_the_first(service: Service):
    done = orbitfb("policies", "rollback", "--data", service.data)
    assert (done.returncode, done.stdout) == (2, "")
    assert "no policy was active before the present one" in done.stderr
    assert active(service) == service.status()["policy"] == service.where["policy"]


def test_activate_reaches_the_running_loop(service: Service):
    other = max(set(listed(service)) - {service.where["policy"]})
    assert ask(service, "policies", "activate", other).split()[:2] == ["policy", other]
    service.wait_status("swap", lambda status: status["policy"] == other, START)
    assert active(service) == other


@pytest.mark.parametrize("name", ["svd-000000000000", "../../etc", "", "-x"])
def test_a_policy_that_is_not_there_changes_nothing(service: Service, name: str):
    before = active(service)
    done = orbitfb("policies", "activate", "--data", service.data, "--", name)
    assert (done.returncode, done.stdout) == (2, "")
    assert "orbitfb policies list" in done.stderr
    assert active(service) == service.status()["policy"] == before


def swaps(archived: Transitions) -> NDArray[np.intp]:
    """Rows of which the policy is another than that of the row before."""
    return np.flatnonzero(archived.policy_id[1:] != archived.policy_id[:-1]) + 1


def test_no_tick_was_lost_by_any_swap(service: Service):
    wait_for("the last swap on disk", lambda: len(swaps(transitions(service.data))) >= 3, 5.0)
    archived = transitions(service.data)
    swapped = swaps(archived)
    assert len(swapped) == 3
    assert (np.diff(archived.tick) == 1).all()
    # Whoever decided, decided on the very next orbit: the wait for it is one as at any other tick,
    # of a computer that stalls now and then (a long stall leaves a tick without an orbit). What a
    # swap itself costs, all three of them would show.
    gaps = archived.next_time - archived.time
    seen, usual = gaps[swapped], gaps[np.isfinite(gaps)]
    seen = seen[np.isfinite(seen)]
    assert len(seen) >= 2
    assert seen.min() < max(2.5 / RATE_HZ, float(np.quantile(usual, 0.99)))


def test_list_stars_the_active_one(service: Service):
    text = ask(service, "policies", "list")
    starred = [line for line in text.splitlines() if line.startswith("* ")]
    assert [line.split()[1] for line in starred] == [active(service)]
    assert re.search(rf"parent {service.where['policy']}$", text, re.MULTILINE)


@pytest.fixture(scope="module")
def stopped(service: Service) -> Service:
    """The same after the service has stopped; only its directory is left."""
    service.stop()
    assert service.popen.returncode == 0
    return service


def archive(stopped: Service) -> Path:
    return stopped.data / "archive"


def test_refit_from_the_archive_stores_and_does_not_activate(stopped: Service):
    before = active(stopped)
    report = json.loads(ask(stopped, "refit", "--from", archive(stopped), "--json"))
    assert report["incumbent_id"] == before
    assert report["rows"] > 300 and report["figures"].keys() >= FIGURES
    assert ("stored" in report) == (report["decision"] == "accepted")
    assert active(stopped) == before


def test_refit_from_the_archive_with_activate(stopped: Service):
    """From the baseline, as anybody would who comes with an archive alone."""
    baseline = stopped.where["policy"]
    ask(stopped, "policies", "activate", baseline)
    arguments = ("refit", "--from", archive(stopped), "--activate")
    report = json.loads(ask(stopped, *arguments, "--json"))
    assert (report["incumbent_id"], report["decision"]) == (baseline, "promoted")
    assert report["policy"] == report["stored"] == active(stopped)
    card = json.loads(ask(stopped, "policies", "show", report["stored"]))
    assert (card["parent"], len(card["data_hash"])) == (baseline, 64)
    assert ask(stopped, "policies", "rollback").split()[1] == active(stopped) == baseline


def test_refit_from_an_archive_needs_no_service_and_no_store(stopped: Service, tmp_path: Path):
    done = orbitfb("refit", "--from", archive(stopped), "--data", tmp_path / "new", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["incumbent_id"] == stopped.where["policy"]


def test_a_listing_of_nothing_says_what_to_do(tmp_path: Path):
    done = orbitfb("policies", "list", "--data", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("no policies stored yet: `orbitfb run` stores its baseline")
    assert list(tmp_path.iterdir()) == []
