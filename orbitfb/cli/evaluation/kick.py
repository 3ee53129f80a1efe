"""The command of the kick experiment."""

from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.options import (
    ConfigFile,
    EffectsFile,
    EffectSpecs,
    chosen_effects,
    configure,
    make_out,
    validated,
)


def evaluate_kick_command(
    out: Annotated[Path, typer.Option(help="Directory for kick.json, kick.md and kick.png.")],
    law: Annotated[
        list[str] | None,
        typer.Option(
            help="Law: svd, told, adaptive, network or told-network; may be given again [all]."
        ),
    ] = None,
    error: Annotated[
        str,
        typer.Option(
            help="The ring starts at the end of this drift, and the controllers have the "
            "response from before it: none, paper, mild or strong."
        ),
    ] = "mild",
    matrix_error: Annotated[
        float,
        typer.Option(help="Independent error of every entry of the controllers' R, rms [m/A]."),
    ] = 1e-6,
    prior: Annotated[
        str,
        typer.Option(help="stated: the learner knows how large the error is; or configured."),
    ] = "stated",
    kicks: Annotated[int, typer.Option(help="How many kicks.")] = 8,
    size: Annotated[float, typer.Option(help="Each kick at the BPMs, rms [m].")] = 250e-6,
    window: Annotated[int, typer.Option(help="Ticks between two kicks.")] = 150,
    settle: Annotated[int, typer.Option(help="Ticks before the first kick.")] = 400,
    seed: Annotated[int, typer.Option(help="Seed of ring, noise, errors and kicks.")] = 1,
    rate: Annotated[float, typer.Option(help="Ticks per second: an accelerated clock.")] = 50.0,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    config_file: ConfigFile = None,
) -> None:
    """Recovery from random kicks over Channel Access, the response wrong by a stated amount."""
    from orbitfb.evaluate.kick.experiment import evaluate_kick
    from orbitfb.evaluate.kick.report import table, write
    from orbitfb.evaluate.kick.settings import KickSettings

    settings = configure(config_file, effect=chosen_effects(effect, effects), effects_file=effects)
    asked = {
        "error": error,
        "matrix_error": matrix_error,
        "prior": prior,
        "kicks": kicks,
        "kick_rms": size,
        "window": window,
        "settle": settle,
        "seed": seed,
        "rate_hz": rate,
    }
    laws = {"laws": tuple(law)} if law else {}
    common = {
        "planes": settings.ring.planes,
        "policy": settings.policy,
        "learn": settings.learn,
        "effects": settings.effect,
    }
    kind = settings.policy.kind
    chosen = {} if kind == "svd" else {"network_kind": kind}
    asked_for = validated(
        KickSettings,
        {**asked, **laws, **common, **chosen},
        laws="law",
        kick_rms="size",
        rate_hz="rate",
        matrix_error="matrix-error",
    )
    make_out(out)
    result = evaluate_kick(asked_for, lambda said: print(said, flush=True))
    write(result, out)
    print(table(result))
    print(f"written: {out / 'kick.json'}, {out / 'kick.md'}, {out / 'kick.png'}")
