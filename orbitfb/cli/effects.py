"""Commands about the effects that a simulated ring can have."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from orbitfb.cli.options import AsJson, show

if TYPE_CHECKING:
    from orbitfb.effects.kinds import EffectKind

effects = typer.Typer(help="List the effects that a simulated ring can have.")


@effects.callback(invoke_without_command=True)
def effects_list(context: typer.Context, as_json: AsJson = False) -> None:
    """List the effects that a simulated ring can have, and that a diagnosis knows."""
    if context.invoked_subcommand is not None:
        return
    from orbitfb.effects.registry import all_effects

    kinds = all_effects().values()
    if as_json:
        show({"effects": [_facts(kind) for kind in kinds]}, as_json=True)
        return
    from rich.console import Console
    from rich.table import Table

    table = Table("effect", "stage", "parameters", "what it means", box=None, pad_edge=False)
    for kind in kinds:
        table.add_row(kind.id, kind.stage, _parameters(kind), kind.sentence)
    console = Console()
    Console(width=max(console.width, 120)).print(table)
    print("orbitfb effects show ID tells more; orbitfb run --ioc sim --effect ID:KEY=VALUE,…")


@effects.command("show")
def effects_show(
    name: Annotated[str, typer.Argument(metavar="ID", help="Of the effect.")],
    as_json: AsJson = False,
) -> None:
    """Show one effect: equation, parameters, and the effects that look like it."""
    from orbitfb.effects.registry import effect

    kind = effect(name)
    if as_json:
        show(_facts(kind), as_json=True)
        return
    print(f"{kind.id}: {kind.title}\n{kind.sentence}\n")
    print(f"acts on    {kind.stage}, on {_where(kind)}")
    print(f"equation   {kind.equation}")
    for p in kind.parameters:
        unit = "" if p.unit == "1" else f" {p.unit}"
        bounds = f"{p.low:g} to {p.high:g}{unit}, none at {p.nominal:g}, typical {p.typical:g}"
        print(f"{p.name:<10} {p.description} ({bounds})")
    if kind.confused_with:
        print(f"like       {', '.join(kind.confused_with)}")
        print(f"tell apart {kind.splits}")


def _parameters(kind: "EffectKind") -> str:
    return ", ".join(p.name if p.unit == "1" else f"{p.name} [{p.unit}]" for p in kind.parameters)


def _where(kind: "EffectKind") -> str:
    words = {"bpm": "BPMs", "ring": "the whole ring", "source": "places that kick the beam"}
    return words.get(kind.target, f"{kind.target}s")


def _facts(kind: "EffectKind") -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "id": kind.id,
        "stage": kind.stage,
        "target": kind.target,
        "title": kind.title,
        "sentence": kind.sentence,
        "equation": kind.equation,
        "parameters": [asdict(parameter) for parameter in kind.parameters],
        "confused_with": list(kind.confused_with),
        "splits": kind.splits,
    }
