"""Commands about the configuration."""

import json
from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.options import (
    ConfigFile,
    configure,
)

config = typer.Typer(help="Print and check the configuration.", no_args_is_help=True)


@config.command("show")
def configshow(config_file: ConfigFile = None) -> None:
    """Print the configuration in force as TOML, each key with its meaning."""
    from orbitfb.config_text import to_toml

    print(to_toml(configure(config_file)))


@config.command("check")
def config_check(path: Annotated[Path, typer.Argument(help="Configuration file (TOML).")]) -> None:
    """Say whether a configuration file is good, its ring and the names of masks included."""
    from orbitfb.policies.masking import mask_of

    settings = configure(path)
    mask_of(settings.ring.load().channels(settings.ring.planes), settings.masks)
    print(f"{path}: good")


@config.command("schema")
def config_schema() -> None:
    """Print the JSON schema of the configuration."""
    from orbitfb.config import AppConfig

    print(json.dumps(AppConfig.model_json_schema(), indent=2))
