"""Commands about stored policies."""

import json
import sys
from typing import Annotated

import typer

from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    DataDirectory,
    Drift,
    EffectsFile,
    EffectSpecs,
    Planes,
    chosen_effects,
    configure,
    show,
    validated,
)

Force = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Activate it even if it tripped the loop, was rolled back, or would be unstable.",
    ),
]

policies = typer.Typer(help="Policies in the store of a data directory.", no_args_is_help=True)


@policies.command("list")
def policies_list(
    config_file: ConfigFile = None, data: DataDirectory = None, as_json: AsJson = False
) -> None:
    """List the stored policies; the active one is starred."""
    from orbitfb.app.setup.stored_policies import list_policies

    rows = list_policies(configure(config_file, data_directory=data))
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        star = "*" if row["active"] else " "
        print(
            f"{star} {row['id']:<24} {row['kind']:<8} {row['planes']:<3} {row['created']}  "
            f"parent {row['parent'] or '-'}"
        )
        on_probation = "on probation: the learner watches it" if row["probation"] else None
        for trouble in filter(None, (on_probation, row["failure"], row["warning"], row["damage"])):
            print(f"    {trouble}")
    if not rows:
        print("no policies stored yet: `orbitfb run` stores its baseline, a refit its candidates")


@policies.command("show")
def policiesshow(
    policy: Annotated[str, typer.Argument(help="Id of the policy.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
) -> None:
    """Print the card of a policy."""
    from orbitfb.app.setup.stored_policies import show_policy

    print(json.dumps(show_policy(configure(config_file, data_directory=data), policy), indent=2))


@policies.command("activate")
def policies_activate(
    policy: Annotated[str, typer.Argument(help="Id of the policy.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    force: Force = False,
) -> None:
    """Make a policy the active one, in the running service too if there is one."""
    from orbitfb.app.setup.stored_policies import activate_policy

    settings = configure(config_file, data_directory=data, ring__planes=planes)
    show(activate_policy(settings, policy, force), as_json=False)


@policies.command("rollback")
def policies_rollback(
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    force: Force = False,
) -> None:
    """Go back to the policy that was active before; skip policies that failed."""
    from orbitfb.app.setup.stored_policies import activate_policy

    settings = configure(config_file, data_directory=data, ring__planes=planes)
    show(activate_policy(settings, None, force), as_json=False)


@policies.command("compare")
def policies_compare(
    ids: Annotated[
        list[str] | None, typer.Argument(help="Ids of stored policies [the active one].")
    ] = None,
    no_baseline: Annotated[
        bool, typer.Option("--no-baseline", help="Leave out the policy of the configuration.")
    ] = False,
    ticks: Annotated[int, typer.Option(help="Length of each run [ticks].")] = 1000,
    seed: Annotated[int, typer.Option(help="First seed of ring, noise and drift.")] = 1,
    seeds: Annotated[int, typer.Option(help="How many seeds.")] = 4,
    drift: Drift = None,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    as_json: AsJson = False,
) -> None:
    """Run policies on the same simulated ring, with the same noise, and set them side by side.

    The simulated ring is that of the configuration (`plant`); a drift takes the whole run.
    """
    from orbitfb.app.setup import stored_policies
    from orbitfb.core.ports import Policy
    from orbitfb.evaluate.compare import CompareSettings, as_rows, as_table, compare
    from orbitfb.policies.masking import MaskedPolicy, mask_of

    config = configure(
        config_file,
        data_directory=data,
        ring__planes=planes,
        plant__drift__preset=drift,
        plant__drift__ticks=None if drift is None else ticks,
        effect=chosen_effects(effect, effects),
        effects_file=effects,
    )
    settings = validated(
        CompareSettings,
        {
            "ticks": ticks,
            "seed": seed,
            "seeds": seeds,
            "planes": config.ring.planes,
            "plant": config.plant,
            "effects": config.effect,
            "period": config.loop.period,
        },
    )
    ring = config.ring.load()
    channels = ring.channels(config.ring.planes)
    valid, movable = mask_of(channels, config.masks)
    store = stored_policies.open_store(config)
    active = store.active()
    compared: dict[str, Policy] = {}
    for policy_id in ids or ([active] if active else []):
        policy = store.load(policy_id, channels)
        compared[policy_id] = (
            policy if movable.all() else MaskedPolicy(policy, policy.response, movable)
        )
    if not no_baseline:
        first = stored_policies.baseline(config, ring, lambda line: print(line, file=sys.stderr))
        compared.setdefault(first.policy_id, first)
    rows = compare(compared, settings, ring, valid, lambda line: print(line, file=sys.stderr))
    print(json.dumps(as_rows(rows), indent=2) if as_json else as_table(rows))
