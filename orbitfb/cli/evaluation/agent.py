"""The command that trains an agent and sets it beside the laws of this program."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    Drift,
    EffectsFile,
    EffectSpecs,
    Planes,
    chosen_effects,
    configure,
    make_out,
    validated,
)


def evaluate_agent_command(
    out: Annotated[Path, typer.Option(help="Directory for agent.safetensors and agent.json.")],
    agent: Annotated[
        Path | None, typer.Option(help="Stored agent to compare, instead of training one.")
    ] = None,
    algorithm: Annotated[str, typer.Option(help="ppo, sac or td3 of stable-baselines3.")] = "ppo",
    steps: Annotated[int, typer.Option(help="Ticks of training.")] = 20_000,
    coordinates: Annotated[
        str, typer.Option(help="What the agent sees and moves: modes of the known R, or devices.")
    ] = "modes",
    modes: Annotated[
        int,
        typer.Option(help="How many of the strongest modes it sees and moves; 0: all."),
    ] = 8,
    train_seed: Annotated[
        int, typer.Option(help="Seed of its weights, its exploration and its rings.")
    ] = 0,
    ticks: Annotated[int, typer.Option(help="Length of each run of the comparison [ticks].")] = 500,
    seed: Annotated[int, typer.Option(help="First seed of ring, noise and drift.")] = 1,
    seeds: Annotated[int, typer.Option(help="How many seeds.")] = 4,
    drift: Drift = None,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    config_file: ConfigFile = None,
    planes: Planes = None,
    as_json: AsJson = False,
) -> None:
    """Train an agent without a model, and compare it with the laws on rings it has not seen.

    A drift takes the whole run, and the agent learns on rings that drift.
    """
    import json
    from importlib.util import find_spec

    from orbitfb.core.errors import ConfigError
    from orbitfb.evaluate.agent import evaluate_agent, read_agent, write
    from orbitfb.evaluate.compare import CompareSettings, as_rows, as_table

    config = configure(
        config_file,
        ring__planes=planes,
        plant__drift__preset=drift,
        plant__drift__ticks=None if drift is None else ticks,
        effect=chosen_effects(effect, effects),
        effects_file=effects,
    )
    asked = {
        "ticks": ticks,
        "seed": seed,
        "seeds": seeds,
        "planes": config.ring.planes,
        "plant": config.plant,
        "effects": config.effect,
        "period": config.loop.period,
    }
    settings = validated(CompareSettings, asked)
    ring = config.ring.load()
    channels = ring.channels(config.ring.planes)

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    if agent is not None:
        make_out(out)
        policy, training = read_agent(agent, channels)
    elif find_spec("stable_baselines3") is None or find_spec("gymnasium") is None:
        raise ConfigError("training an agent needs the extra 'rl': pip install 'orbitfb[rl]'")
    else:
        from orbitfb.gym.environment import OrbitFeedbackEnv
        from orbitfb.gym.training import AgentSettings, train_agent

        chosen = {
            "algorithm": algorithm,
            "steps": steps,
            "coordinates": coordinates,
            "modes": modes if modes and coordinates == "modes" else None,
            "seed": train_seed,
        }
        how = validated(AgentSettings, chosen, seed="train-seed")
        make_out(out)
        environment = OrbitFeedbackEnv(
            config.ring.planes,
            config.plant,
            config.effect,
            how.coordinates,
            how.modes,
            period=config.loop.period,
            places=config.ring.places,
            parameters=config.ring.parameters,
        )
        policy, training = train_agent(environment, how, say)
    result = evaluate_agent(policy, training, settings, ring, config.policy, say)
    write(result, channels, out)
    if as_json:
        print(json.dumps(as_rows(result.rows), indent=2))
    else:
        print(as_table(result.rows))
        print(f"written: {out / 'agent.safetensors'}, {out / 'agent.json'}")
