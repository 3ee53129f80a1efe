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
    from orbitfb.config.text import to_toml

    print(to_toml(configure(config_file)))


@config.command("check")
def config_check(path: Annotated[Path, typer.Argument(help="Configuration file (TOML).")]) -> None:
    """Check a configuration file and the files that it names."""
    from orbitfb.app.service.interfaces import check_panel
    from orbitfb.app.setup.stored_policies import baseline, check_policy
    from orbitfb.measure.response_file import nominal_response
    from orbitfb.policies.masking import mask_of
    from orbitfb.policies.settings import LINEAR

    settings = configure(path)
    ring, planes = settings.ring.load(), settings.ring.planes
    mask_of(ring.channels(planes), settings.masks)
    nominal_response(ring, planes, settings.ring.response, settings.masks)
    if settings.policy.kind in LINEAR:  # the others are trained, which takes long
        check_policy(baseline(settings, ring), settings)
    check_panel(settings, ring.channels(planes))
    print(f"{path}: good")


@config.command("schema")
def config_schema() -> None:
    """Print the JSON schema of the configuration."""
    from orbitfb.config.tree import AppConfig

    print(json.dumps(AppConfig.model_json_schema(), indent=2))
