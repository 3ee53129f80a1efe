"""What the commands share: options, configuration, the way answers are printed."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

if TYPE_CHECKING:
    from orbitfb.config.tree import AppConfig
    from orbitfb.core.settings import Settings
    from orbitfb.physics import places as physics_places

S = TypeVar("S", bound="Settings")

Ioc = Annotated[
    str,
    typer.Option(
        "--ioc",
        help="sim: a simulated ring in a child process; HOST[:PORT]: an IOC there [port 15064]; "
        "env: by the EPICS_CA_… environment; config: by [epics] of the configuration.",
    ),
]
ConfigFile = Annotated[Path | None, typer.Option("--config", help="Configuration file (TOML).")]
DataDirectory = Annotated[
    Path | None, typer.Option("--data", help="Data directory [orbitfb-data].")
]
Planes = Annotated[str | None, typer.Option(help="Planes under feedback: x, y or xy [x].")]
Seed = Annotated[int | None, typer.Option(help="Seed of the simulated ring and of the dither.")]
Rate = Annotated[float | None, typer.Option(help="Ticks per second, loop and soft IOC [10].")]
Port = Annotated[int | None, typer.Option(help="Port of the soft IOC; 0: any free one [15064].")]
PolicyKind = Annotated[
    str | None,
    typer.Option(
        "--policy",
        help="Kind of policy: svd, modal, adaptive, network, supervised or trajectory [svd].",
    ),
]
Drift = Annotated[
    str | None, typer.Option(help="Drift of the simulated ring: none, paper, mild, strong.")
]
DriftTicks = Annotated[int | None, typer.Option(help="Ticks that the drift takes.")]
EffectSpecs = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="SPEC",
        help="Effect of the simulated ring, ID:KEY=VALUE,…, for example "
        "corrector-lag:tau=0.1s,cells=3-5,from=30s,planes=x. Give names=A+B instead of "
        "cells, or neither for all devices. Omitted parameters take typical values. Cells "
        "5-3 wrap around the ring. Repeatable; `orbitfb effects` lists all [those of the "
        "configuration].",
    ),
]
EffectsFile = Annotated[
    Path | None,
    typer.Option(
        "--effects",
        help="File with effects of the simulated ring (TOML), as `orbitfb diagnose` writes it "
        "[those of the configuration].",
    ),
]
RecordPlanes = Annotated[
    str | None,
    typer.Option("--planes", help="Planes to look at: x, y or xy [those of the record]."),
]
PlacesTable = Annotated[
    Path | None,
    typer.Option("--places", help="Table of places (CSV) [that of the default ring]."),
]
RingParameters = Annotated[
    Path | None,
    typer.Option("--ring", help="Parameters of the ring (JSON) [those of the default ring]."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def configure(path: Path | None, effects_file: Path | None = None, **options: Any) -> "AppConfig":
    """Compose the configuration; an option `loop__rate_hz` is the key `loop.rate_hz`.

    Args:
        path: Of the configuration file.
        effects_file: Where effects among the options are from.
        options: By key.

    Raises:
        ConfigError: The configuration is wrong, or the effects of the file are not of its ring.
    """
    from orbitfb.config.load import load_config

    settings = load_config(
        path, {name.replace("__", "."): value for name, value in options.items()}
    )
    if effects_file is not None:
        _check_effects(settings, effects_file)
    return settings


def data_directory(config_file: Path | None, data: Path | None) -> Path:
    """Give the data directory; the configuration, half a second, is read where there is one.

    Args:
        config_file: What `--config` says.
        data: What `--data` says.

    Raises:
        ConfigError: The configuration is wrong.
    """
    from orbitfb.config.defaults import DATA_DIRECTORY, ENVIRONMENT_PREFIX

    if config_file is None and not any(name.startswith(ENVIRONMENT_PREFIX) for name in os.environ):
        return data or Path(DATA_DIRECTORY)
    return configure(config_file, data_directory=data).data_directory


def _check_effects(settings: "AppConfig", file: Path) -> None:
    """See that what a file of effects names is there, before a process is started for it."""
    from orbitfb.core.errors import ConfigError
    from orbitfb.effects.build import layout_of
    from orbitfb.effects.files import read_effects
    from orbitfb.effects.places import resolve

    layout = layout_of(settings.ring.load(), settings.ring.planes, settings.loop.period)
    for its in read_effects(file):
        try:
            resolve(its, layout)
        except ConfigError as error:
            raise ConfigError(
                f"--effects {file} is not of this ring and cannot be simulated on it: {error}"
            ) from error


def chosen_effects(specs: list[str] | None, file: Path | None) -> "list[dict[str, Any]] | None":
    """Read the effects of the command line, those of the file first; None: none are given."""
    if not specs and file is None:
        return None
    from orbitfb.effects.files import read_effects
    from orbitfb.effects.settings import parse_effect

    effects = [*(read_effects(file) if file else ()), *map(parse_effect, specs or ())]
    return [its.model_dump(mode="json", by_alias=True) for its in effects]


def validated(model: type[S], values: dict[str, Any], **options: str) -> S:
    """Build settings of a command; what is wrong is named by its option.

    Args:
        model: The settings.
        values: By the settings' names.
        options: Name of the option of a setting where it is another one.
    """
    from pydantic import ValidationError

    from orbitfb.core.errors import ConfigError

    try:
        return model.model_validate(values)
    except ValidationError as error:
        problems: dict[str, str] = {}  # the first of an option: a list is also too short
        for problem in error.errors():
            name = str(problem["loc"][0])
            option = options.get(name, name)
            problems.setdefault(option, f"--{option}: {problem['msg']}, got {problem['input']!r}")
        raise ConfigError("; ".join(problems.values())) from None


def planes_of(text: str | None) -> "physics_places.Planes | None":
    """Check the planes to look at; None: those of the record.

    Raises:
        ConfigError: There are no such planes.
    """
    from orbitfb.core.errors import ConfigError

    match text:
        case None | "x" | "y" | "xy":
            return text
        case _:
            raise ConfigError(f"--planes: there is no {text!r}; choose x, y or xy")


def path_of(text: str) -> Path:
    """Take a path; an empty one, which would be the current directory, is none.

    Raises:
        typer.BadParameter: It is empty.
    """
    if not text.strip():
        raise typer.BadParameter("it is empty; name a path, or . for the current directory")
    return Path(text)


def make_out(directory: Path) -> None:
    """Make the directory of an evaluation, before the work that is to end there.

    Raises:
        ConfigError: It cannot be made, or cannot be written to.
    """
    import tempfile

    from orbitfb.core.errors import ConfigError

    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise ConfigError(
            f"--out {directory}: it cannot be written to ({error.strerror}); name a directory "
            "that can be made or written to"
        ) from error


def pairs(values: list[str]) -> dict[str, Any]:
    """Read what goes with a command: KEY=VALUE each, values as JSON, else as text.

    Raises:
        ConfigError: One is no pair.
    """
    import json

    from orbitfb.core.errors import ConfigError

    read: dict[str, Any] = {}
    for pair in values:
        key, equals, value = pair.partition("=")
        if not key or not equals:
            raise ConfigError(f"{pair}: give KEY=VALUE, as in plane=x")
        try:
            read[key] = json.loads(value)
        except ValueError:
            read[key] = value
    return read


def show(answer: dict[str, Any], as_json: bool) -> None:
    """Print an answer, for people or as JSON."""
    from orbitfb.cli.text import as_json as json_of
    from orbitfb.cli.text import as_text

    print(json_of(answer) if as_json else as_text(answer))
