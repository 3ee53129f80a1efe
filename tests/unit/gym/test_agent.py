"""Agents of stable-baselines3 as policies: what they decide, kept without a pickle."""

import json

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import A2C, PPO, SAC, TD3

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError, TrainingError
from orbitfb.evaluate.agent import read_agent, write_agent
from orbitfb.gym.environment import OrbitFeedbackEnv
from orbitfb.gym.training import AgentSettings, policy_of, train_agent
from orbitfb.physics.places import Ring

CHANNELS = Ring.load().channels("x")


@pytest.fixture(scope="module")
def environment():
    return OrbitFeedbackEnv()


@pytest.mark.parametrize("kind", [PPO, SAC, TD3])
@pytest.mark.parametrize("activation", [torch.nn.Tanh, torch.nn.ReLU])
def test_the_policy_decides_what_the_agent_decides(environment, kind, activation):
    limited = gymnasium.wrappers.TimeLimit(environment, 10)
    shape = {"net_arch": [32, 16], "activation_fn": activation}
    memory = {} if kind is PPO else {"buffer_size": 10}
    model = kind("MlpPolicy", limited, policy_kwargs=shape, seed=1, device="cpu", **memory)
    agent = policy_of(model, environment)
    rng = np.random.default_rng(1)
    for _ in range(5):
        seen = rng.uniform(-50, 50, 180).astype(np.float32)
        decided, _ = model.predict(seen, deterministic=True)
        np.testing.assert_allclose(agent.decide(seen), decided, atol=2e-5)
    orbit = rng.standard_normal(180) * 100e-6
    seen = environment.scaling.see(orbit)
    expected = environment.scaling.move @ model.predict(seen, deterministic=True)[0]
    change, _ = agent.act(orbit, np.ones(180, dtype=bool), None)
    np.testing.assert_allclose(change, expected, atol=1e-4 * np.abs(expected).max())


def test_an_agent_of_another_kind_is_refused(environment):
    model = A2C("MlpPolicy", gymnasium.wrappers.TimeLimit(environment, 10), device="cpu")
    with pytest.raises(TrainingError, match="A2C"):
        policy_of(model, environment)


@pytest.fixture(scope="module")
def trained(environment):
    settings = AgentSettings(steps=300, width=8, seed=4)
    return train_agent(environment, settings), settings


@pytest.mark.nightly
def test_the_same_seed_trains_the_same_agent(environment, trained):
    (agent, training), settings = trained
    again, _ = train_agent(OrbitFeedbackEnv(), settings)
    assert again.policy_id == agent.policy_id
    assert training["settings"]["steps"] == 300 and training["reward_per_episode"]


def test_masked_bpms_are_filled_in(trained):
    agent = trained[0][0]
    orbit = np.random.default_rng(0).standard_normal(180) * 1e-4
    valid = np.ones(180, dtype=bool)
    whole, _ = agent.act(orbit, valid, None)
    valid[7] = False
    masked, _ = agent.act(np.where(valid, orbit, np.nan), valid, None)
    assert np.isfinite(masked).all() and not np.array_equal(masked, whole)


def test_there_and_back_through_a_file(tmp_path, trained):
    agent, training = trained[0]
    write_agent(tmp_path / "a.safetensors", agent, CHANNELS, training)
    back, told = read_agent(tmp_path / "a.safetensors", CHANNELS)
    assert back.policy_id == agent.policy_id and told == training
    orbit = np.random.default_rng(0).standard_normal(180) * 1e-4
    valid = np.ones(180, dtype=bool)
    assert np.array_equal(back.act(orbit, valid, None)[0], agent.act(orbit, valid, None)[0])
    with pytest.raises(ConfigError, match="planes"):
        read_agent(tmp_path / "a.safetensors", Ring.load().channels("y"))
    content = (tmp_path / "a.safetensors").read_bytes()
    (tmp_path / "a.safetensors").write_bytes(content[: len(content) // 2])
    with pytest.raises(ConfigError):
        read_agent(tmp_path / "a.safetensors", CHANNELS)


def test_the_command_sets_it_beside_the_laws(tmp_path, trained, capsys):
    agent, training = trained[0]
    write_agent(tmp_path / "a.safetensors", agent, CHANNELS, training)
    command = ["evaluate", "agent", "--agent", str(tmp_path / "a.safetensors"), "--out",
               str(tmp_path / "out"), "--ticks", "30", "--seeds", "1"]  # fmt: skip
    assert app(command, standalone_mode=False) in (None, 0)
    table = capsys.readouterr().out
    report = json.loads((tmp_path / "out/agent.json").read_text())
    assert [row["policy"] for row in report["policies"]] == ["agent", "svd", "modal"]
    assert "agent" in table and "modal" in table
    svd = report["policies"][1]
    assert svd["true_rms"] < 5e-6, "the peer is the real law"
    again, _ = read_agent(tmp_path / "out/agent.safetensors", CHANNELS)
    assert again.policy_id == agent.policy_id


@pytest.mark.parametrize(
    ("option", "value"),
    [("algorithm", "ddpg"), ("steps", "3"), ("coordinates", "polar"), ("ticks", "2"),
     ("train-seed", "-1")],
)  # fmt: skip
def test_bad_options_name_themselves(tmp_path, option, value):
    command = ["evaluate", "agent", "--out", str(tmp_path / "out"), f"--{option}={value}"]
    with pytest.raises(ConfigError) as caught:
        app(command, standalone_mode=False)
    assert str(caught.value).startswith(f"--{option}: ")
    assert not (tmp_path / "out").exists()
