"""Commands about stored policies."""

import json
from typing import Annotated

import typer

from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    DataDirectory,
    Planes,
    configure,
    show,
)

policies = typer.Typer(help="Policies in the store of a data directory.", no_args_is_help=True)


@policies.command("list")
def policies_list(
    config_file: ConfigFile = None, data: DataDirectory = None, as_json: AsJson = False
) -> None:
    """List the stored policies; the active one is starred."""
    from orbitfb.maintenance import list_policies

    rows = list_policies(configure(config_file, data_directory=data))
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        star = "*" if row["active"] else " "
        print(f"{star} {row['id']:<24} {row['created']}  parent {row['parent'] or '-'}")
        if row["damage"]:
            print(f"    {row['damage']}")
    if not rows:
        print("no policies stored yet: `orbitfb run` stores its baseline, a refit its candidates")


@policies.command("show")
def policiesshow(
    policy: Annotated[str, typer.Argument(help="Id of the policy.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
) -> None:
    """Print the card of a policy."""
    from orbitfb.maintenance import show_policy

    print(json.dumps(show_policy(configure(config_file, data_directory=data), policy), indent=2))


@policies.command("activate")
def policies_activate(
    policy: Annotated[str, typer.Argument(help="Id of the policy.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
) -> None:
    """Make a policy the active one, in the running service too if there is one."""
    from orbitfb.maintenance import activate_policy

    settings = configure(config_file, data_directory=data, ring__planes=planes)
    show(activate_policy(settings, policy), as_json=False)


@policies.command("rollback")
def policies_rollback(
    config_file: ConfigFile = None, data: DataDirectory = None, planes: Planes = None
) -> None:
    """Go back to the policy that was active before."""
    from orbitfb.maintenance import activate_policy

    settings = configure(config_file, data_directory=data, ring__planes=planes)
    show(activate_policy(settings, None), as_json=False)
