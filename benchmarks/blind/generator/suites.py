"""Which cases a suite has."""

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np

from benchmarks.blind.generator.cases import Spec
from benchmarks.blind.generator.conditions import Dither
from benchmarks.blind.generator.draft import invented, known

Suite = Literal["quick", "fast", "full", "healthy"]
DITHERS: tuple[Dither, ...] = ("passive", "white", "shaped")


def plan(suite: Suite, seed: int) -> list[Spec]:
    """List the cases of a suite, in a fixed order (they are shuffled when they are written)."""
    rng = np.random.default_rng([seed, 7])
    makers = {"quick": _quick, "fast": _fast, "full": _full, "healthy": _healthy}
    return list(makers[suite](rng))


def _spec(
    rng: np.random.Generator, effects: tuple[str, ...], target: float, **wish: object
) -> Spec:
    """A case whose circumstances are drawn where nothing is wished."""
    every = {**known(), **invented()}
    needs = {every[name].planes for name in effects}
    if "xy" in needs:
        planes = "xy"
    elif "x" in needs:
        planes = "x"
    else:
        planes = str(rng.choice(["x", "y", "xy"], p=[0.72, 0.2, 0.08]))
    filled: dict[str, Any] = {
        "planes": planes,
        "ring": "first",
        "dither": "passive",
        "ticks": int(rng.integers(15, 31)) * 100,
        "later": 1000,
        "seed": int(rng.integers(1, 2**31)),
        "inside": False,
        **wish,
    }
    return Spec(effects=effects, target=target, **filled)


def _quick(rng: np.random.Generator) -> Iterator[Spec]:
    """Every known effect once, well detectable; four records without a gap."""
    for number, (name, maker) in enumerate(known().items()):
        planes = "xy" if maker.planes == "xy" else "x"
        target = float(rng.uniform(12, 30))
        dither = DITHERS[number % 3] if number % 2 else "passive"
        yield _spec(rng, (name,), target, planes=planes, dither=dither, ticks=1500, later=500)
    for number in range(4):
        dither = DITHERS[number % 3]
        yield _spec(rng, (), 0.0, planes="x", dither=dither, ticks=1500, later=500)


def _fast(rng: np.random.Generator) -> Iterator[Spec]:
    """Some 230 cases: a quarter of an hour on two cores."""
    for name in known():
        yield _spec(rng, (name,), 12.0, dither="passive", ticks=1500)
        yield _spec(rng, (name,), 30.0, dither=str(rng.choice(["white", "shaped"])), ticks=1500)
    for name in list(known())[::4]:
        yield _spec(rng, (name,), 6.0, dither="passive")
        yield _spec(rng, (name,), 6.0, dither="shaped")
    for name in list(known())[1::9]:
        yield _spec(rng, (name,), 3.0)
    yield from _no_gap(rng, 40, 1500)
    for name in invented():
        yield _spec(rng, (name,), 12.0, ticks=1500)
        yield _spec(rng, (name,), 30.0, dither="white", ticks=1500)
    yield from _pairs(rng, 16)
    yield from _inside(rng, 10)
    yield from _second(rng, 12)


def _full(rng: np.random.Generator) -> Iterator[Spec]:
    """Some 1700 cases."""
    for target, repeats in ((3.0, 1), (6.0, 4), (12.0, 4), (30.0, 3)):
        for _ in range(repeats):
            for name in known():
                yield _spec(rng, (name,), target, dither="passive")
                yield _spec(rng, (name,), target, dither=str(rng.choice(["white", "shaped"])))
    yield from _no_gap(rng, 300, None)
    for _ in range(4):
        for name in invented():
            yield _spec(rng, (name,), 12.0, dither=str(rng.choice(DITHERS)))
            yield _spec(rng, (name,), 30.0, dither=str(rng.choice(DITHERS)))
    yield from _pairs(rng, 100)
    yield from _inside(rng, 60)
    yield from _second(rng, 60)


def _healthy(rng: np.random.Generator) -> Iterator[Spec]:
    """Records without a gap: how much evidence there is where there is nothing."""
    yield from _no_gap(rng, 40, 1500)


def _no_gap(rng: np.random.Generator, count: int, ticks: int | None) -> Iterator[Spec]:
    for number in range(count):
        wish: dict[str, object] = {"dither": DITHERS[number % 3], "background": number % 4 > 0}
        if ticks is not None:
            wish["ticks"] = ticks
        if number % 8 == 7:
            wish["ring"] = "second"
        yield _spec(rng, (), 0.0, **wish)


def _pairs(rng: np.random.Generator, count: int) -> Iterator[Spec]:
    names = [
        name for name, maker in known().items() if maker.planes == "any" and not maker.unstable
    ]
    for number in range(count):
        first, second = rng.choice(names, 2, replace=False)
        dither = "passive" if number % 2 else "shaped"
        yield _spec(rng, (str(first), str(second)), float(rng.choice([12.0, 30.0])), dither=dither)


def _inside(rng: np.random.Generator, count: int) -> Iterator[Spec]:
    names = [name for name, maker in known().items() if maker.onset == "either"]
    for number in range(count):
        name = str(rng.choice(names))
        dither = DITHERS[number % 3]
        yield _spec(rng, (name,), float(rng.choice([12.0, 30.0])), dither=dither, inside=True)


def _second(rng: np.random.Generator, count: int) -> Iterator[Spec]:
    """A ring of other size and tunes, rectangular; only what needs no table of places."""
    stages = ("sensor", "actuator", "timing", "noise")
    names = [n for n, m in known().items() if m.stage in stages and m.planes == "any"]
    for number in range(count):
        name, target = str(rng.choice(names)), float(rng.choice([12.0, 30.0]))
        dither = DITHERS[number % 3]
        yield _spec(rng, (name,), target, ring="second", dither=dither)
