"""The configuration of the whole service: one frozen tree, from file, environment and options.

Later sources win: defaults, the TOML file, `ORBITFB_SECTION__KEY` environment variables, command
line options. Paths in the file are relative to it, those of the others to the working directory.
A key that nobody knows or a value of the wrong type is refused with its path and the place that it
came from.
"""

import json
import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError
from pydantic_core import ErrorDetails

from orbitfb.config.paths import seen_from
from orbitfb.core.errors import ConfigError
from orbitfb.core.files.bounded import LARGEST_TEXT, parse_toml, read_text
from orbitfb.core.near_names import near_names
from orbitfb.core.settings import Settings, without
from orbitfb.diagnose.settings import DiagnoseSettings
from orbitfb.effects.settings import EffectSettings
from orbitfb.epics.lease.lease import LeaseSettings
from orbitfb.epics.settings import EpicsSettings
from orbitfb.history.settings import ArchiveSettings
from orbitfb.learn.settings import LearnSettings
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.excitation.dither import DitherSettings
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.timing.timeouts import RULES
from orbitfb.measure.settings import MeasureSettings
from orbitfb.models.forward.settings import ForwardSettings
from orbitfb.observe.settings import ObserveSettings
from orbitfb.page.settings import WebSettings
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import PlantSettings
from orbitfb.policies.masking import MaskSettings
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.training.supervised_settings import SupervisedSettings
from orbitfb.policies.training.trajectory_settings import StructuredSettings, TrajectorySettings
from orbitfb.postmortem.settings import PostMortemSettings
from orbitfb.safety.frequency import RfSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.sim.settings import SimSettings

ENVIRONMENT_PREFIX = "ORBITFB_"

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

_FORMS = {
    "bool_type": "write true or false",
    "tuple_type": 'write a list, as in ["A", "B"]',
    "list_type": 'write a list, as in ["A", "B"]',
    "dict_type": 'write a table, as in { name = "A" }',
}
"""What to write, where a value is of the wrong type."""


class RingSettings(Settings):
    """Which ring is under feedback."""

    places: Path | None = Field(
        default=None, description="Places table (CSV); none: the default ring."
    )
    parameters: Path | None = Field(
        default=None, description="Ring parameters (JSON); none: the default ring."
    )
    planes: Planes = Field(default="x", description="Planes under feedback: x, y or xy.")
    response: Path | None = Field(
        default=None,
        description="Measured response matrix, as `orbitfb measure-response` writes it; none: that "
        "of the optics.",
    )

    def load(self) -> Ring:
        """Read the ring that these settings name."""
        return Ring.load(self.places, self.parameters)


class TrainSettings(Settings):
    """How `orbitfb train` trains."""

    samples: int = Field(
        default=8,
        ge=0,
        description="Response matrices drawn from the posterior for an iteration, when an archive "
        "is given [1]; 0: R̂ alone.",
    )
    supervised: SupervisedSettings = Field(
        default=SupervisedSettings(), description="Training on labels."
    )
    begin: Literal["random", "embedded"] = Field(
        default="embedded",
        description="What a trajectory training begins with: random weights (the paper), or the "
        "modal law written into the network.",
    )
    trajectory: TrajectorySettings = Field(
        default=TrajectorySettings(
            trained="output",
            horizon=10,
            loss="log",
            smallest_amplitude=0.05e-6,
            reading_noise=0.2e-6,
            kick_noise=0.04e-6,
            learning_rate=3e-4,
            final_learning_rate=3e-5,
        ),
        description="Training of a network through the model; the defaults are for a beginning "
        "with the embedded law.",
    )
    structured: StructuredSettings = Field(
        default=StructuredSettings(), description="Training of the modal law through the model."
    )
    forward: ForwardSettings = Field(
        default=ForwardSettings(), description="Training of the forward net."
    )


class HistorySettings(Settings):
    """What is kept of the transitions."""

    capacity: int = Field(default=20_000, ge=100, description="Ticks kept in memory.")
    archive: ArchiveSettings = Field(default=ArchiveSettings(), description="The archive on disk.")


class AppConfig(Settings):
    """Everything that can be configured."""

    data_directory: Path = Field(
        default=Path("orbitfb-data"),
        validate_default=False,  # it is a path already, where a file has text
        description="Where policies, archive and log are kept.",
    )
    seed: int = Field(
        default=1,
        ge=0,
        description="Seed of the simulated ring, of what is asked of it, and of the dither.",
    )
    policies_kept: int = Field(
        default=100,
        ge=2,
        description="Newest promotions of the learner, and last ones in force, that are kept; "
        "what was trained, imported, measured or activated is never removed.",
    )
    policy: PolicySettings = Field(
        default=PolicySettings(), description="The law that runs, and that of every refit."
    )
    masks: MaskSettings = Field(
        default=MaskSettings(), description="BPMs that do not count, correctors that do not move."
    )
    ring: RingSettings = Field(default=RingSettings(), description="The ring.")
    loop: LoopSettings = Field(default=LoopSettings(), description="The loop.")
    correction: CorrectionSettings = Field(
        default=CorrectionSettings(), description="Corrections of an open loop by hand."
    )
    dither: DitherSettings = Field(default=DitherSettings(), description="The dither.")
    limits: LimitSettings = Field(default=LimitSettings(), description="Limits of a write.")
    interlocks: InterlockSettings = Field(
        default=InterlockSettings(), description="What holds or trips the loop."
    )
    rf: RfSettings = Field(
        default=RfSettings(), description="The RF frequency, that follows the energy."
    )
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")
    diagnose: DiagnoseSettings = Field(
        default=DiagnoseSettings(), description="Diagnosis beside the loop."
    )
    measure: MeasureSettings = Field(
        default=MeasureSettings(), description="The command measure-response."
    )
    train: TrainSettings = Field(default=TrainSettings(), description="The command train.")
    history: HistorySettings = Field(
        default=HistorySettings(), description="Transitions in memory and on disk."
    )
    postmortem: PostMortemSettings = Field(
        default=PostMortemSettings(), description="What is kept of a trip."
    )
    observe: ObserveSettings = Field(
        default=ObserveSettings(), description="Metrics, health and logs."
    )
    web: WebSettings = Field(default=WebSettings(), description="The operator page.")
    panel: PanelSettings = Field(default=PanelSettings(), description="The loop's own PVs.")
    lease: LeaseSettings = Field(
        default=LeaseSettings(), description="Who of several controllers writes to the machine."
    )
    epics: EpicsSettings = Field(default=EpicsSettings(), description="Channel Access.")
    sim: SimSettings = Field(default=SimSettings(), description="The soft IOC.")
    plant: PlantSettings = Field(
        default=PlantSettings(), description="The simulated ring behind the soft IOC."
    )
    effect: tuple[EffectSettings, ...] = Field(
        default=(),
        description="Effects that the simulated ring has besides; a table `effect` each.",
    )


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
        lines = dict(_key_lines(text))
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
        told = [_explain(problem, origins) for problem in error.errors()]
        config, problems = None, _once(told)
    if config is None or problems:
        listed = "\n".join(f"  {problem}" for problem in problems)
        raise ConfigError(
            f"the configuration is refused:\n{listed}\n"
            "`orbitfb config show` prints every key with its value and meaning."
        )
    return config


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
    return config, problems


_LONGEST_SHOWN = 200
_HEADER = re.compile(r"^\s*\[\[?\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*[A-Za-z0-9_"'-]+)*)\s*=""")


def _key_lines(text: str) -> Iterator[tuple[str, int]]:
    """Yield every key of a TOML text by dotted path with the line where it stands."""
    table = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = _plain(header.group(1))
            yield table, number
        elif key := _KEY.match(line):
            name = _plain(key.group(1))
            yield (f"{table}.{name}" if table else name), number


def _plain(dotted: str) -> str:
    return ".".join(part.strip().strip("\"'") for part in dotted.split("."))


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


def _explain(problem: ErrorDetails, origins: Mapping[str, str]) -> str:
    location = [str(part) for part in problem["loc"]]
    dotted = ".".join(location) or "the configuration"
    above = (".".join(location[:end]) for end in range(len(location), 0, -1))
    below = (key for key in origins if key.startswith(f"{dotted}."))
    origin = next((origins[key] for key in chain(above, below) if key in origins), "default")
    if problem["type"] == "extra_forbidden":
        return f"{dotted}: no such key ({origin}){_did_you_mean(location)}"
    its, where = (origin, f"key {dotted}") if origin.startswith("--") else (dotted, origin)
    form = f"; {_FORMS[problem['type']]}" if problem["type"] in _FORMS else ""
    return f"{its}: {problem['msg']}, got {_short(problem['input'])} ({where}){form}"


def _once(problems: list[str]) -> list[str]:
    """Leave out what an option that sets several keys has wrong a second time."""
    first: dict[str, str] = {}
    for problem in problems:
        first.setdefault(problem.rpartition(" (")[0] if problem.startswith("--") else problem,
                         problem)  # fmt: skip
    return list(first.values())


def _short(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= _LONGEST_SHOWN else f"{shown[:_LONGEST_SHOWN]}…"


def _did_you_mean(location: list[str]) -> str:
    model: Any = AppConfig
    for part in location[:-1]:
        field = getattr(model, "model_fields", {}).get(part)
        model = field.annotation if field else None
    known = list(getattr(model, "model_fields", {}))
    if near := near_names(location[-1], known, most=1):
        return f"; did you mean {near[0]}?"
    return f"; known here: {', '.join(known)}" if known else ""
