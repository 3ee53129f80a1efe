"""`orbitfb run --policy KIND`: every kind runs, is refitted, stored and shown."""

import json
import os
import signal
from pathlib import Path

import pytest
from service_process import Service, orbitfb, refused, rms, transitions, wait_for

pytestmark = pytest.mark.system

MASKED_BPM, MASKED_CORRECTOR = 4, 7


def service(directory: Path, kind: str, *options: object, text: str = "") -> Service:
    config = directory / "orbitfb.toml"
    patient = "[loop]\npolicy_deadline = 50.0\n"  # a busy computer is not what is shown
    waiting = "[learn]\nevery = 1000000\nchi2_trigger = 1e9\n"
    waiting += "[learn.changes]\nminimum_sensitivity = 1e9\n"
    lenient = "[learn.judge]\nmargin = 0.0\nresolved = false\nevidence = 1e6\n"
    config.write_text(patient + waiting + lenient + text)
    drift = ("--drift", "paper", "--drift-ticks", 100)
    asked = ("--policy", kind, "--rate", 50.0, "--config", config, *drift, *options)
    return Service(directory / "data", "sim", *asked, learn=True)


def ask(running: Service, *arguments: object) -> str:
    done = orbitfb(*arguments, "--data", running.data)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


@pytest.mark.nightly
@pytest.mark.timing
@pytest.mark.parametrize(
    ("kind", "stored"),
    [("modal", "modal"), ("trajectory", "network")],
)
def test_a_kind_runs_is_refitted_and_shown(kind: str, stored: str, tmp_path: Path):
    with service(tmp_path, kind) as running:
        running.wait_status("ticks", lambda status: status["ticks"] > 400, 30.0)
        running.wait_below(2.0)
        report = json.loads(ask(running, "refit", "--activate", "--json"))
        assert report["decision"] == "promoted", report["reason"]
        assert report["stage"] == "shadow" and report["figures"]["shadow_ticks"] == 20
        card = json.loads(ask(running, "policies", "show", report["policy_id"]))
        assert (card["kind"], card["parent"]) == (stored, running.where["policy"])
        running.wait_status("swap", lambda s: s["policy"] == report["policy_id"], 2.0)
        running.stop()
    archive = running.data / "archive"
    again = ("refit", "--from", archive, "--policy", kind, "--data", running.data, "--json")
    done = orbitfb(*again)
    assert (done.returncode, done.stderr) == (0, "")
    offline = json.loads(done.stdout)
    assert offline["incumbent_id"] == report["policy_id"]
    assert offline["figures"].keys() >= {"recovery_candidate", "predicted_rms_candidate"}
    rows = transitions(running.data)
    assert (rows.tick[1:] - rows.tick[:-1] == 1).all()  # no tick lost by the swap


@pytest.mark.nightly
@pytest.mark.timing
def test_masked_elements_do_not_count_and_do_not_move(tmp_path: Path):
    from orbitfb.physics.places import Ring

    channels = Ring.load().channels("x")
    bpm, corrector = channels.bpms[MASKED_BPM], channels.correctors[MASKED_CORRECTOR]
    masks = f'[masks]\nbpms = ["{bpm}"]\ncorrectors = ["{corrector}"]\n'
    with service(tmp_path, "modal", text=masks) as running:
        running.wait_status("ticks", lambda status: status["ticks"] > 150, 30.0)
        running.wait_below(2.0)
        running.wait_status(
            "nothing to say", lambda status: not status["reason"], 5.0
        )  # held back?
        status = running.status()
        assert (status["bpms_masked"], status["bpms_invalid"]) == (1, 0)
        json.loads(ask(running, "refit", "--activate", "--json"))
        running.wait_status("more ticks", lambda status: status["ticks"] > 220, 30.0)
        running.stop()
    rows = transitions(running.data)
    assert not rows.valid[:, MASKED_BPM].any()
    assert (rows.applied[:, MASKED_CORRECTOR] == 0).all()
    assert (rows.setpoints[:, MASKED_CORRECTOR] == rows.setpoints[0, MASKED_CORRECTOR]).all()
    assert rms(rows.applied)[:100].max() > 0


@pytest.mark.nightly
def test_a_trainer_that_is_killed_is_told_and_replaced(tmp_path: Path):
    with service(tmp_path, "svd") as running:
        running.wait_status("ticks", lambda status: status["ticks"] > 50, 30.0)
        trainer = running.child("orbitfb.learn")
        os.kill(trainer.pid, signal.SIGKILL)
        wait_for("report", lambda: running.events("refit_judged"))
        [event] = running.events("refit_judged")
        assert event["decision"] == "refused" and f"process {trainer.pid} ended" in event["reason"]
        ticks = running.status()["ticks"]
        report = json.loads(ask(running, "refit", "--json"))  # waits for the new one
        assert running.status()["ticks"] > ticks  # which the loop does not
        assert report["rows"] > 40
        assert running.child("orbitfb.learn").pid != trainer.pid


def test_an_unknown_kind_is_refused(tmp_path: Path):
    said = refused("run", "--ioc", "sim", "--policy", "magic", "--data", tmp_path / "data")
    assert "policy.kind" in said
