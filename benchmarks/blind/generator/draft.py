"""What a drawn effect is, and the list of all that can be drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.machine import Nature

Stage = Literal["sensor", "actuator", "optics", "disturbance", "noise", "timing"]
Law = Literal["mean", "random", "rare", "spikes"]
Onset = Literal["start", "inside", "either"]
Drawer = Callable[[Conditions, np.random.Generator], "Draft"]


@dataclass
class Draft:
    """An effect with its places, still without its size.

    Args:
        places: Names of the devices.
        build: Makes it for a size; to be called anew for every run.
        figures: Parameters for a size: name → (value, unit).
        size: Where the search of the size begins; 0 for an effect without a size.
        limit: Largest size that makes sense.
        least: Least size that makes sense.
        law: How it shows: in the mean, as randomness of every tick, at rare
            unknown ticks, or in rare unknown readings.
        closed: Expected gain of log-likelihood per row [nats] for a size, where there is a formula
            and no difference of two runs tells it (an upper bound: the moving orbit blurs it).
    """

    places: list[str]
    build: Callable[[float], Nature]
    figures: Callable[[float], dict[str, tuple[float, str]]]
    size: float
    limit: float
    law: Law = "mean"
    least: float = 0.0
    closed: Callable[[float], float] | None = None


@dataclass(frozen=True)
class Maker:
    """A kind of effect of the generator."""

    id: str
    stage: Stage
    draw: Drawer
    planes: Literal["any", "xy", "x"] = "any"
    onset: Onset = "either"
    known: bool = True
    unstable: bool = False
    equal: tuple[str, ...] = field(default=())


MAKERS: dict[str, Maker] = {}


def kind(
    name: str,
    stage: Stage,
    planes: Literal["any", "xy", "x"] = "any",
    onset: Onset = "either",
    known: bool = True,
    unstable: bool = False,
) -> Callable[[Drawer], Drawer]:
    """Enter a drawer into the list."""

    def enter(draw: Drawer) -> Drawer:
        MAKERS[name] = Maker(name, stage, draw, planes, onset, known, unstable)
        return draw

    return enter


def known() -> Mapping[str, Maker]:
    """Effects that a library of effects is asked to hold."""
    return {name: maker for name, maker in MAKERS.items() if maker.known}


def invented() -> Mapping[str, Maker]:
    """Effects that exist in no library."""
    return {name: maker for name, maker in MAKERS.items() if not maker.known}
