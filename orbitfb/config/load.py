"""The configuration from its sources: defaults, file, environment and options; later ones win.

The file is TOML, the environment has `ORBITFB_SECTION__KEY`, and some keys are options of the
command line. Paths in the file are relative to it, those of the others to the working directory. A
key that nobody knows or a value of the wrong type is refused with its path and the place that it
came from.
"""

import json
import math
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from orbitfb.config.defaults import ENVIRONMENT_PREFIX
from orbitfb.config.key_lines import key_lines
from orbitfb.config.paths import seen_from
from orbitfb.config.refusals import refusals
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.files.bounded import LARGEST_TEXT, parse_toml, read_text
from orbitfb.core.settings import without
from orbitfb.loop.timing.timeouts import RULES
from orbitfb.policies.blocks import damped, sized

OPTIONS = {
    "data_directory": "--data",
    "effect": "--effect",
    "loop.rate_hz": "--rate",
    "measure.amplitude": "--amplitude",
    "measure.at_once": "--at-once",
    "observe.port": "--metrics-port",
    "plant.drift.preset": "--drift",
    "plant.drift.ticks": "--drift-ticks",
    "policy.kind": "--policy",
    "ring.parameters": "--ring",
    "ring.places": "--places",
    "ring.planes": "--planes",
    "seed": "--seed",
    "sim.lockstep": "--lockstep",
    "sim.plain": "--plain",
    "sim.port": "--port",
    "sim.rate_hz": "--rate",
}
"""What the command line calls a key."""


def load_config(
    path: Path | None = None,
    options: Mapping[str, Any] | None = None,
    environment: Mapping[str, str] | None = None,
) -> AppConfig:
    """Compose the configuration.

    Args:
        path: A TOML file, or None.
        options: Values from the command line by dotted path, `{"loop.rate_hz": 20.0}`; those
            that are None are left out.
        environment: Where to look for `ORBITFB_…`; the process's own by default.

    Raises:
        ConfigError: A file that cannot be read, a key that nobody knows, a value that does not
            fit: all of them at once, each with its path and its origin.
    """
    tree: dict[str, Any] = {}
    origins: dict[str, str] = {}
    if path is not None:
        text = read_text(path, LARGEST_TEXT, ConfigError, "name a TOML file with --config")
        tree = seen_from(parse_toml(text, path, ConfigError), AppConfig, path.parent)
        lines = dict(key_lines(text))
        origins = {key: f"{path}, line {line}" for key, line in lines.items()}
    for variable, value in sorted((os.environ if environment is None else environment).items()):
        if variable.startswith(ENVIRONMENT_PREFIX):
            dotted = variable.removeprefix(ENVIRONMENT_PREFIX).lower().replace("__", ".")
            _put(tree, dotted, _environment_value(value), f"environment variable {variable}")
            origins[dotted] = f"environment variable {variable}"
    for dotted, value in (options or {}).items():
        if value is not None:
            origins[dotted] = OPTIONS.get(dotted, "command line")
            _put(tree, dotted, value, origins[dotted])
    try:
        # As JSON, strictly: "10" is no number and 1 is no truth value, but text may be a path.
        text = json.dumps(without(tree, AppConfig), default=str)
        config, problems = _fitted(AppConfig.model_validate_json(text, strict=True))
    except ValidationError as error:
        config, problems = None, refusals(error.errors(), origins)
    if config is None or problems:
        listed = "\n".join(f"  {problem}" for problem in problems)
        raise ConfigError(
            f"the configuration is refused:\n{listed}\n"
            "`orbitfb config show` prints every key with its value and meaning."
        )
    return _planned(config)


def _planned(config: AppConfig) -> AppConfig:
    """Give the law of each plane the sizes of that plane, if there are laws by plane."""
    svd, modal = config.policy.svd, config.policy.modal
    if not svd.planes and not modal.planes:
        return config
    channels = config.ring.load().channels(config.ring.planes)
    if svd.planes:
        svd = svd.model_copy(update={"planes": sized(svd.planes, channels)})
    if modal.planes:
        planes = damped(modal.planes, modal.regularisation, channels)
        modal = modal.model_copy(update={"planes": planes})
    policy = config.policy.model_copy(update={"svd": svd, "modal": modal})
    return config.model_copy(update={"policy": policy})


def _fitted(config: AppConfig) -> tuple[AppConfig, list[str]]:
    """Let time-outs follow the rate; give what of several keys does not fit together."""
    problems: list[str] = []
    for rule in RULES:
        section, name = rule.key.split(".")
        node = getattr(config, section)
        value = getattr(node, name)
        if value is None:
            continue
        fitted = rule.fitted(value, name in node.model_fields_set, config.loop)
        if math.isnan(fitted):
            problems.append(rule.refusal(value, config.loop))
        elif fitted != value:
            node = node.model_copy(update={name: fitted})
            config = config.model_copy(update={section: node})
    watched, known = config.interlocks.current_channel, config.epics.auxiliary
    if config.interlocks.current_min is not None and watched not in known:
        problems.append(
            f"interlocks.current_min = {config.interlocks.current_min:g}: the loop could never "
            f"close, as epics.auxiliary has no channel {watched!r}; name its PV there, or set "
            "interlocks.current_min = false"
        )
    if (fast := config.interlocks.fast_feedback_channel) and fast not in known:
        problems.append(
            f"interlocks.fast_feedback_channel = {fast!r}: the loop could never close, as "
            "epics.auxiliary has no channel of this name; name the PV of its status there"
        )
    planes = [
        plane for plane in config.fast_feedback.reference_pvs if plane not in config.ring.planes
    ]
    if planes:
        problems.append(
            f"fast_feedback.reference_pvs: {', '.join(planes)} is not under feedback; add it to "
            "ring.planes, or leave its PV out"
        )
    if config.fast_feedback.reference_pvs and not config.interlocks.fast_feedback_channel:
        problems.append(
            "fast_feedback.reference_pvs: nobody knows when the fast feedback is closed; name its "
            "status with interlocks.fast_feedback_channel"
        )
    return config, problems


def _environment_value(value: str) -> Any:
    """Read a value as TOML would; text that is no TOML value stays text."""
    try:
        return tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        return value


def _put(tree: dict[str, Any], dotted: str, value: Any, origin: str) -> None:
    *parents, last = dotted.split(".")
    for depth, parent in enumerate(parents, start=1):
        child = tree.setdefault(parent, {})
        if not isinstance(child, dict):
            raise ConfigError(
                f"{origin}: {dotted} lies below {'.'.join(parents[:depth])}, which is already "
                f"set to {child!r}, a plain value"
            )
        tree = child
    tree[last] = value
