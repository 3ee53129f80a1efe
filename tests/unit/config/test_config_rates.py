"""Off is said in words, time-outs fit the rate, and an interlock has its channel."""

import json
from pathlib import Path
from typing import Any

import pytest

from orbitfb.config.load import load_config
from orbitfb.config.text import to_toml
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError

RATES = (0.1, 0.2, 0.5, 1.0, 10.0, 100.0)


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "c.toml"
    file.write_text(text)
    return file


@pytest.mark.parametrize("word", ["false", '"off"', '"none"', '"Off"'])
def test_an_interlock_is_switched_off_in_words(
    word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)  # what is shown has paths as seen from here
    keys = ("current_min", "distortion_rate", "readback_tolerance")
    text = "[interlocks]\n" + "".join(f"{key} = {word}\n" for key in keys)
    config = load_config(written(tmp_path, text), environment={})
    assert [getattr(config.interlocks, key) for key in keys] == [None] * 3
    shown = written(Path(), to_toml(config))
    assert "current_min = false" in shown.read_text()
    assert load_config(shown, environment={}) == config


@pytest.mark.parametrize("word", ["false", "off", "none", "OFF"])
def test_the_environment_says_it_too(word: str):
    config = load_config(environment={"ORBITFB_INTERLOCKS__CURRENT_MIN": word})
    assert config.interlocks.current_min is None
    assert load_config(environment={"ORBITFB_LOOP__TRIP_AFTER": word}).loop.trip_after is None


def test_a_slow_channel_never_goes_stale_in_words_too(tmp_path: Path):
    text = '[epics.auxiliary.current]\npv = "I"\nstale_after = false\n'
    config = load_config(written(tmp_path, text), environment={})
    assert config.epics.auxiliary["current"].stale_after is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("interlocks.bpm_frozen_ticks", "off"),
        ("loop.rate_hz", "none"),
        ("loop.rate_hz", False),
        ("interlocks.current_min", True),
        ("interlocks.current_min", "0.01"),
    ],
)
def test_what_cannot_be_off_stays_refused(key: str, value: object):
    with pytest.raises(ConfigError, match=key):
        load_config(options={key: value}, environment={})


def test_a_path_may_be_called_off():
    assert load_config(options={"ring.places": "off"}, environment={}).ring.places == Path("off")


def test_the_schema_takes_the_words():
    schema: dict[str, Any] = AppConfig.model_json_schema()
    kinds = schema["$defs"]["InterlockSettings"]["properties"]["current_min"]["anyOf"]
    assert {"enum": [False, "off", "none"]} in kinds
    assert "enum" not in json.dumps(schema["$defs"]["RingSettings"]["properties"]["places"])


def test_an_interlock_without_its_channel_is_refused(tmp_path: Path):
    file = written(tmp_path, "[epics]\nauxiliary = {}\n")
    with pytest.raises(ConfigError, match=r"current_min.*epics.auxiliary.*current_min = false"):
        load_config(file, environment={})
    off = {"interlocks.current_min": False}
    assert load_config(file, off, environment={}).epics.auxiliary == {}


@pytest.mark.parametrize("rate", RATES)
def test_timeouts_that_nobody_set_follow_the_rate(rate: float):
    config = load_config(options={"loop.rate_hz": rate}, environment={})
    assert config.epics.silent_after >= max(2.0, 3 / rate)
    assert config.observe.stale_after > config.loop.patience
    if rate >= 2.0:
        assert config.epics == AppConfig().epics and config.observe == AppConfig().observe


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize(
    ("key", "bad", "good"),
    [
        ("epics.silent_after", 1.0, 1.01),
        ("observe.stale_after", 1.9, 1.91),
        ("loop.trip_after", 3.0, 3.01),
        ("epics.stamp_window", 0.5, 0.49),
    ],
)
def test_timeouts_that_do_not_fit_are_refused(rate: float, key: str, bad: float, good: float):
    """In periods."""
    options = {"loop.rate_hz": rate, key: good / rate}
    section, name = key.split(".")
    config = load_config(options=options, environment={})
    assert getattr(getattr(config, section), name) == good / rate
    with pytest.raises(ConfigError, match=rf"{key}.* does not fit loop.rate_hz"):
        load_config(options=options | {key: bad / rate}, environment={})
