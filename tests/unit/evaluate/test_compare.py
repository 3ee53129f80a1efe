"""Policies side by side: the figures against closed forms, the command as people call it."""

import json

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError, StoreError
from orbitfb.evaluate.compare import CompareSettings, as_rows, as_table, compare
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings
from orbitfb.physics.response import response
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = Ring.load()
RESPONSE = response(RING, "x")
NOISE = 0.2e-6
QUIET = PlantSettings(ground_motion_rms=0.0)


def run(policy, plant=QUIET, ticks=400, seeds=2):
    settings = CompareSettings(ticks=ticks, seeds=seeds, plant=plant)
    return compare({"it": policy}, settings, RING)[0]


def test_a_linear_law_has_the_orbit_that_its_lyapunov_equation_says():
    """With reading noise v alone: x' = (I − R K) x − R K v."""
    policy = SvdPolicy(RESPONSE, SvdSettings(gain=0.4, regularisation=1e-5))
    row = run(policy)
    answer = RESPONSE @ policy.gain_matrix
    covariance = solve_discrete_lyapunov(np.eye(180) - answer, NOISE**2 * answer @ answer.T)
    true = np.sqrt(np.trace(covariance) / 180)
    assert row.true_rms == pytest.approx(true, rel=0.03)
    assert row.observed_rms == pytest.approx(np.hypot(true, NOISE), rel=0.02)
    total = covariance + NOISE**2 * np.eye(180)
    change = np.sqrt(np.trace(policy.gain_matrix @ total @ policy.gain_matrix.T) / 180)
    assert row.change_rms == pytest.approx(change, rel=0.03)


@pytest.mark.parametrize(("gain", "steps"), [(1.0, 1), (0.5, 3), (0.2, 8)])
def test_steps_and_growth_of_a_whole_inverse_are_powers_of_its_gain(gain, steps):
    row = run(SvdPolicy(RESPONSE, SvdSettings(gain=gain, regularisation=0.0)), ticks=40, seeds=1)
    assert row.growth == pytest.approx(1.0 - gain, abs=1e-6)
    assert row.steps == steps  # 250 µm · (1 − g)^k ≤ 50 µm
    assert row.lost == 0


def test_a_law_of_the_wrong_sign_is_lost_and_its_figures_are_not_numbers():
    settings = CompareSettings(ticks=60, seeds=2, plant=QUIET)
    good = SvdPolicy(RESPONSE, SvdSettings(regularisation=0.0))
    bad = SvdPolicy(-RESPONSE, SvdSettings(regularisation=0.0), "bad")
    rows = compare({"bad": bad, "good": good}, settings, RING)
    assert (rows[0].lost, rows[0].true_rms, rows[0].steps) == (2, np.inf, np.inf)
    assert rows[0].growth == pytest.approx(1.5, abs=1e-6)
    answer = json.loads(json.dumps(as_rows(rows), allow_nan=False))
    assert answer[0]["true_rms"] is None
    assert answer[1]["true_rms"] == rows[1].true_rms
    lines = as_table(rows).splitlines()
    assert lines[2].startswith("good") and lines[3].startswith("bad")
    assert " - " in lines[3]


def test_the_noise_aware_law_is_quieter_than_the_baseline():
    """What the module of the modal law says, on the plant's own ground motion."""
    settings = CompareSettings(ticks=600, seeds=2)
    rows = compare(
        {
            "svd": SvdPolicy(RESPONSE, SvdSettings()),
            "modal": ModalPolicy(RESPONSE, ModalSettings()),
        },
        settings,
        RING,
    )
    assert rows[1].true_rms < 0.8 * rows[0].true_rms
    assert rows[1].steps <= rows[0].steps


def test_all_policies_meet_the_same_noise():
    policy = SvdPolicy(RESPONSE, SvdSettings())
    settings = CompareSettings(ticks=40, seeds=1)
    first, second = compare({"a": policy, "b": policy}, settings, RING)
    assert (first.true_rms, first.observed_rms) == (second.true_rms, second.observed_rms)


def test_a_masked_bpm_is_not_used():
    valid = np.arange(180) != 7
    policy = SvdPolicy(RESPONSE, SvdSettings())
    settings = CompareSettings(ticks=40, seeds=1)
    assert compare({"a": policy}, settings, RING, valid) != compare({"a": policy}, settings, RING)


@pytest.mark.parametrize(
    ("policies", "words"),
    [
        ({}, "nothing to compare"),
        (
            {"small": SvdPolicy(np.eye(4), SvdSettings())},
            "small is for 4 BPMs and 4 correctors, the ring has 180 and 180 in planes x",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(policies, words):
    with pytest.raises(ConfigError, match=words):
        compare(policies, CompareSettings(), RING)


@pytest.fixture
def data(tmp_path):
    store = PolicyStore(tmp_path / "policies")
    law = ModalPolicy(RESPONSE, ModalSettings(), policy_id="mine")
    store.save(law, RING.channels("x"))
    return tmp_path


def invoke(data, *words):
    return CliRunner().invoke(app, ["policies", "compare", *words, "--data", str(data)])


def test_the_command_prints_a_table_or_json(data):
    short = ("--ticks", "20", "--seeds", "1")
    table = invoke(data, "mine", *short)
    assert table.exit_code == 0
    assert "ModalPolicy" in table.stdout and "SvdPolicy" in table.stdout
    rows = json.loads(invoke(data, "mine", "--no-baseline", "--json", *short).stdout)
    assert [(row["policy"], row["kind"]) for row in rows] == [("mine", "ModalPolicy")]


def test_without_ids_the_command_takes_the_active_policy(data):
    PolicyStore(data / "policies").activate("mine")
    answer = invoke(data, "--json", "--ticks", "20", "--seeds", "1", "--drift", "strong")
    assert json.loads(answer.stdout)[0]["policy"] == "mine"


def test_a_policy_of_another_ring_is_named(data):
    answer = invoke(data, "mine", "--planes", "y")
    assert isinstance(answer.exception, StoreError)
    assert "mine" in str(answer.exception) and "planes 'x'" in str(answer.exception)
