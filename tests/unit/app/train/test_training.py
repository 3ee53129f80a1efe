"""What `orbitfb train` does, without its command line."""

import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest

from orbitfb.app.setup import stored_policies
from orbitfb.app.setup.stored_policies import open_store
from orbitfb.app.train.policy import train_policy
from orbitfb.app.train.request import METHODS, TrainingRequest
from orbitfb.cli.app import app
from orbitfb.cli.text import as_text
from orbitfb.config.load import load_config
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError, ControlError, StoreError

QUICK = {
    "train.supervised.batch": 4,
    "train.trajectory.batch": 2,
    "train.trajectory.horizon": 2,
    "train.structured.batch": 2,
    "train.structured.horizon": 2,
}
DESCENDING = ("structured", "supervised", "trajectory")


@pytest.fixture
def config(tmp_path: Path) -> AppConfig:
    return load_config(None, {"data_directory": str(tmp_path), **QUICK}, {})


def request_for(method: str, **options) -> TrainingRequest:
    iterations = 3 if method in DESCENDING else None
    return TrainingRequest(method, iterations=iterations, device="cpu", **options)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_ends_in_the_store_with_its_card(config, method):
    answer = train_policy(config, request_for(method))
    card = open_store(config).card(answer["stored"])
    assert card.training is not None
    assert card.training["method"] == method
    if method in DESCENDING:
        assert len(card.training["curve"]) == 3
        assert card.training["settings"]["iterations"] == 3
        assert np.isfinite(answer["loss_last"])


def test_it_may_be_put_in_force(config):
    answer = train_policy(config, request_for("modal", activate=True))
    assert open_store(config).active() == answer["stored"]


def test_progress_says_how_many_of_how_many(config):
    told = []
    train_policy(config, request_for("trajectory"), lambda *said: told.append(said))
    assert [done for done, _, _ in told] == [1, 2, 3]
    assert {total for _, total, _ in told} == {3}


def test_an_interrupted_training_goes_on_to_the_same_weights(config, tmp_path):
    def stop(done: int, _total: int, _loss: float) -> None:
        if done == 3:
            signal.raise_signal(signal.SIGINT)

    request = TrainingRequest("trajectory", iterations=6, device="cpu")
    whole = train_policy(config, request)
    other = config.model_copy(update={"data_directory": tmp_path / "other"})
    with pytest.raises(KeyboardInterrupt):
        train_policy(other, request, stop)
    told = []
    resumed = train_policy(other, request, lambda done, *_: told.append(done))
    assert told == [4, 5, 6]
    assert resumed["stored"] == whole["stored"]
    assert not any((tmp_path / "other" / "training").iterdir())


def test_a_stored_network_can_be_trained_on(config):
    first = train_policy(config, request_for("network"))["stored"]
    second = train_policy(config, request_for("trajectory", start=first, warm=True))
    card = open_store(config).card(second["stored"])
    assert card.parent == first


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "magic"}, "cannot be trained; choose svd"),
        ({"method": "svd", "iterations": 5}, "--iterations means nothing"),
        ({"method": "modal", "published": True}, "--published means nothing"),
        ({"method": "trajectory", "iterations": 0}, "give at least 1"),
        ({"method": "trajectory", "warm": True}, "name it with --start"),
        ({"method": "svd", "warm": True}, "--warm means nothing"),
        ({"method": "svd", "model": "m"}, "--model means nothing"),
        ({"method": "trajectory", "seed": -1}, "--seed -1"),
        ({"method": "trajectory", "device": "tpu"}, "--device tpu"),
        ({"method": "svd", "device": "cuda"}, "--device cuda means nothing"),
        ({"method": "forward"}, "--validate ARCHIVE"),
    ],
)
def test_what_makes_no_sense_is_refused(config, options, said):
    with pytest.raises(ConfigError, match=said):
        train_policy(config, TrainingRequest(**options))
    assert not (config.data_directory / "policies").exists()


def test_a_start_that_is_not_there_is_named(config):
    with pytest.raises(StoreError, match="no policy 'nobody'"):
        train_policy(config, request_for("svd", start="nobody"))


def test_warm_needs_a_network(config):
    first = train_policy(config, request_for("svd"))["stored"]
    with pytest.raises(ConfigError, match="is no network"):
        train_policy(config, request_for("trajectory", start=first, warm=True))


def test_labels_from_an_archive_need_one(config):
    labels = config.train.supervised.model_copy(update={"source": "archive"})
    train = config.train.model_copy(update={"supervised": labels})
    with pytest.raises(ConfigError, match="--from"):
        train_policy(config.model_copy(update={"train": train}), request_for("supervised"))


def test_the_card_is_plain_json(config):
    answer = train_policy(config, request_for("supervised", published=True))
    path = config.data_directory / "policies" / answer["stored"] / "card.json"
    card = json.loads(path.read_text())
    assert card["training"]["settings"]["coordinates"] == "raw"


def test_what_would_run_away_is_stored_with_a_warning(config):
    """The paper's training, cut short: a network that does not hold its own ring."""
    answer = train_policy(config, request_for("supervised", published=True))
    assert answer["warning"].startswith("unstable: ")
    card = open_store(config).card(answer["stored"])
    assert card.warning == answer["warning"]
    assert card.growth is not None and card.growth > 1.0
    assert "warning" not in train_policy(config, request_for("modal"))


def test_an_activation_that_fails_leaves_the_name_of_what_was_stored(config, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise ControlError("the ring runs 'x'")

    monkeypatch.setattr(stored_policies, "is_running", lambda _: True)
    monkeypatch.setattr(stored_policies, "ask", refuse)
    with pytest.raises(StoreError) as caught:
        train_policy(config, request_for("modal", activate=True))
    [card] = open_store(config).cards(lambda error: pytest.fail(str(error)))
    assert str(caught.value) == (
        f"policy {card.id} is stored in {config.data_directory / 'policies'}, but was not "
        "activated: the ring runs 'x'"
    )


def test_a_baseline_that_is_trained_says_how_far_it_is(config):
    lessons = config.policy.supervised.model_copy(update={"iterations": 20, "batch": 2})
    policy = config.policy.model_copy(update={"kind": "supervised", "supervised": lessons})
    said: list[str] = []
    trained = config.model_copy(update={"policy": policy})
    stored_policies.baseline(trained, trained.ring.load(), said.append)
    assert len(said) == 13
    assert said[0] == "training the first policy (supervised): 20 iterations"
    assert said[1].startswith("training the first policy (supervised): 1 of 20 iterations, loss ")
    assert said[-2].startswith("training the first policy (supervised): 20 of 20 iterations, loss ")
    assert said[-1].startswith("training the first policy (supervised) took ")


def test_the_list_has_kind_planes_and_warning(config, tmp_path, capsys):
    good = train_policy(config, request_for("modal"))["stored"]
    bad = train_policy(config, request_for("supervised", published=True))
    for_y = train_policy(
        config.model_copy(update={"ring": config.ring.model_copy(update={"planes": "y"})}),
        request_for("svd"),
    )["stored"]
    app(["policies", "list", "--data", str(tmp_path)], standalone_mode=False)
    shown = capsys.readouterr().out
    for name, kind, planes in ((good, "modal", "x"), (bad["stored"], "network", "x"),
                               (for_y, "svd", "y")):  # fmt: skip
        assert re.search(rf"^  {name} +{kind} +{planes} +20\d\d-\S+ +parent -$", shown, re.M)
    assert f"    {bad['warning']}\n" in shown


def test_a_structured_law_that_became_worse_gives_way_to_its_start(tmp_path):
    """Three iterations as configured: its gains begin away from those of the modal law."""
    config = load_config(None, {"data_directory": str(tmp_path)}, {})
    start = train_policy(config, request_for("modal"))["stored"]
    answer = train_policy(config, request_for("structured"))
    assert answer["stored"] == start
    assert answer["held_out_after"] >= answer["held_out_before"]
    assert "no better than the one that it began with" in answer["warning"]
    assert "the start is what is stored" in answer["warning"]


def test_a_structured_law_that_became_better_is_stored(config):
    start = train_policy(config, request_for("modal"))["stored"]
    longer = {"batch": 16, "horizon": 6, "learning_rate": 5e-2}
    structured = config.train.structured.model_copy(update=longer)
    train = config.train.model_copy(update={"structured": structured})
    request = TrainingRequest("structured", iterations=25, device="cpu")
    answer = train_policy(config.model_copy(update={"train": train}), request)
    assert answer["stored"] != start
    assert answer["held_out_after"] < answer["held_out_before"] - 0.05


def test_figures_on_the_terminal_have_units_and_those_of_json_are_si(tmp_path, capsys):
    file = tmp_path / "quick.toml"
    file.write_text("[train.structured]\nbatch = 2\nhorizon = 2\n")
    arguments = ["train", "structured", "--iterations", "2", "--device", "cpu"]
    arguments += ["--config", str(file), "--data", str(tmp_path)]
    app(arguments, standalone_mode=False)
    shown = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    app([*arguments, "--json"], standalone_mode=False)
    si = json.loads(capsys.readouterr().out)
    assert shown["stored"] == si["stored"]
    for name in ("before_floor", "after_floor", "before_worst", "after_worst"):
        assert shown[name] == f"{si[name] * 1e6:.4g} µm"
    assert shown["seconds"].endswith(" s")
    assert shown["spectral_radius"] == f"{si['spectral_radius']:.6g}"


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("predicted_rms_candidate", 0.123456e-6, "0.1235 µm"),
        ("change_rms", 0.2, "200 mA"),
        ("duration", 0.05, "0.05 s"),
        ("growth_candidate", 0.95, "0.95"),
    ],
)
def test_figures_of_a_refit_have_units_too(name, value, text):
    assert as_text({"figures": {name: value}}) == f"figures:\n  {name}  {text}"
