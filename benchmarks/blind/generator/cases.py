"""One case: drawn, brought to a stated detectability, run, and told as record and truth."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.generator import (
    invented_actuator,
    invented_sensor,
    nature_actuator,
    nature_disturbance,
    nature_limits,
    nature_link,
    nature_noise,
    nature_optics,
    nature_sensor,
)
from benchmarks.blind.generator.conditions import Conditions, Dither, second_ring
from benchmarks.blind.generator.draft import MAKERS, Draft, Maker
from benchmarks.blind.generator.drawing import draw
from benchmarks.blind.generator.healthy import healthy_errors, healthy_gradients
from benchmarks.blind.generator.machine import Log, run
from benchmarks.blind.generator.oracle import Innovations, Small, detectability
from orbitfb.physics.places import Planes, Ring

NATURE = (
    nature_sensor,
    nature_noise,
    nature_actuator,
    nature_limits,
    nature_link,
    nature_optics,
    nature_disturbance,
    invented_sensor,
    invented_actuator,
)
"""Modules that enter what can be drawn."""

CLOSE = 0.1
"""Relative distance from the wanted d' that is good enough."""

TRIES, FEWEST = 8, 120
"""A beam that is thrown out sooner than that many rows is no record: other devices are drawn, and
after half of the tries the effect begins later."""


@dataclass(frozen=True)
class Spec:
    """What is asked of a case.

    Args:
        effects: Ids of the generator; none for a record without a gap.
        target: d' of every effect.
        planes: `x`, `y` or `xy`.
        ring: `first` or `second`.
        dither: Excitation.
        ticks: Transitions of the record.
        later: Transitions of the later record.
        seed: Of everything drawn.
        inside: Whether effects that may begin anywhere begin inside the record.
        background: Whether the small unknown errors are there.
    """

    effects: tuple[str, ...]
    target: float
    planes: Planes
    ring: Literal["first", "second"]
    dither: Dither
    ticks: int
    later: int
    seed: int
    inside: bool = False
    background: bool = True


Chosen = tuple[int, Maker, Draft, float, float]
"""First row, kind, places, size, d'."""


@dataclass
class Case:
    """A finished case: arrays of the record, of the later record (None: none), and the truth."""

    record: dict[str, NDArray[Any]]
    later: dict[str, NDArray[Any]] | None
    truth: dict[str, Any]


@cache
def first_ring() -> Ring:
    """The packaged ring."""
    return Ring.load()


@cache
def other_ring(folder: Path, seed: int) -> Ring:
    """The ring of a suite that the library does not know."""
    return second_ring(folder, seed)


def make(spec: Spec, folder: Path, suite_seed: int) -> Case:
    """Draw a case and bring its effects to their detectability."""
    case, chosen, log = choose(spec, folder, suite_seed)
    split = min(spec.ticks, len(log.readings) - 1)
    truth = _truth(case, spec, chosen, split)
    later = None
    if len(log.readings) - 1 - split >= 100:
        later = arrays(case, log, split, len(log.readings) - 1)
        truth["later_oracle_nats"] = _held_out(case, chosen, log, spec, split)
    return Case(arrays(case, log, 0, split), later, truth)


def choose(spec: Spec, folder: Path, suite_seed: int) -> tuple[Conditions, list[Chosen], Log]:
    """Draw circumstances and effects of their sizes; the same of the same seeds.

    Returns:
        Circumstances, effects, and the run of all of them.
    """
    ring = first_ring() if spec.ring == "first" else other_ring(folder, suite_seed)
    rng = np.random.default_rng([spec.seed, 1])
    case = draw(
        rng, ring, spec.ring, spec.planes, spec.ticks + spec.later, spec.dither, spec.background
    )
    filter_ = Innovations(case)
    chosen: list[Chosen] = []
    log: Log | None = None
    for number, name in enumerate(spec.effects):
        one, log = _draw(case, MAKERS[name], number, spec, filter_)
        chosen.append(one)
    if len(chosen) != 1 or log is None:
        log = run(
            case, [(start, draft.build(size)) for start, _, draft, size, _ in chosen], spec.seed
        )
    return case, chosen, log


def _draw(
    case: Conditions, maker: Maker, number: int, spec: Spec, filter_: Innovations
) -> tuple[Chosen, Log]:
    """Draw an effect, again when the beam does not survive it for long enough."""
    attempt = 0
    while True:
        # A seed of its own for what is drawn of the effect, whatever else is in the case.
        rng = np.random.default_rng([spec.seed, 2, number, attempt])
        draft = maker.draw(case, rng)
        start = _first_row(case, maker, spec, rng, attempt)
        size, seen, log = _sized(case, maker, draft, (start, number), spec, filter_)
        attempt += 1
        if len(log.readings) > FEWEST or attempt == TRIES:
            return (start, maker, draft, size, seen), log


def _first_row(
    case: Conditions, maker: Maker, spec: Spec, rng: np.random.Generator, attempt: int
) -> int:
    inside = maker.onset == "inside" or (maker.onset == "either" and spec.inside)
    somewhere = case.warm + int(rng.uniform(0.25, 0.7) * spec.ticks)
    if inside or attempt > TRIES // 2:
        return somewhere
    # What would throw the beam out begins with the record; all else has been there for long.
    return case.warm if maker.unstable else 0


def _sized(
    case: Conditions,
    maker: Maker,
    draft: Draft,
    begins: tuple[int, int],
    spec: Spec,
    filter_: Innovations,
) -> tuple[float, float, Log]:
    """Search the size that is as detectable as wanted; an effect without a size is taken as is.

    Args:
        case: Circumstances.
        maker: Of the effect.
        draft: The effect.
        begins: Its first row, and its number among the effects of the case.
        spec: What is asked of the case.
        filter_: Of the case.

    Returns:
        Size, d', and the run of this effect alone.
    """
    start, number = begins
    healthy = healthy_errors(case, maker, draft) if spec.background else []
    gradients = healthy_gradients(case, maker, draft, filter_)
    small = Small(healthy, None if gradients is None else gradients.leave)

    def look(size: float) -> tuple[float, Log]:
        log = run(case, [(start, draft.build(size))], spec.seed, number=number)
        rows = slice(0, spec.ticks + 1)
        seen = detectability(case, log, spec.seed, draft.law, filter_, rows, small)
        if draft.closed is not None:
            rows = min(spec.ticks + 1, len(log.readings)) - max(start - case.warm, 0)
            seen = float(np.sqrt(2 * rows * draft.closed(size)))
        return seen, log

    size = draft.size
    seen, log = look(size)
    if not draft.size:
        return size, seen, log
    low, high = 0.0, draft.limit
    best = (abs(np.log(max(seen, 1e-9) / spec.target)), size, seen, log)
    for _ in range(14):
        if best[0] < CLOSE or (size >= draft.limit and seen < spec.target):
            break
        if size <= draft.least and seen > spec.target:
            return size, seen, log
        if seen < spec.target:
            low = size
        else:
            high = size
        guess = size * np.clip(spec.target / max(seen, 1e-9), 0.1, 8.0)
        if low and high < draft.limit:
            inner = low * (high / low) ** 0.1, high * (low / high) ** 0.1
            guess = guess if inner[0] < guess < inner[1] else np.sqrt(low * high)
        size = float(np.clip(guess, draft.least, draft.limit))
        seen, log = look(size)
        best = min(best, (abs(np.log(max(seen, 1e-9) / spec.target)), size, seen, log), key=_first)
    return best[1], best[2], best[3]


def _held_out(
    case: Conditions, chosen: list[Chosen], log: Log, spec: Spec, split: int
) -> float | None:
    """What knowing the effects gains on the later record [nats]; None where it is not told.

    The small errors are there with the effects and without: the whole change of the readings
    counts. Noise has no such change.
    """
    if not chosen or any(draft.law != "mean" for _, _, draft, _, _ in chosen):
        return None
    rows = slice(split, len(log.readings))
    seen = detectability(case, log, spec.seed, "mean", Innovations(case), rows, Small())
    return seen**2 / 2


def _first(item: tuple[float, float, float, Log]) -> float:
    return item[0]


def arrays(case: Conditions, log: Log, start: int, stop: int) -> dict[str, NDArray[Any]]:
    """Give arrays of transitions start … stop, in the units of records from elsewhere."""
    rows, after = slice(start, stop), slice(start + 1, stop + 1)
    dither = np.diff(case.dither, axis=0, append=case.dither[-1:])[case.warm :]
    meta = {
        "dt_s": case.period,
        "units": {"orbit": "mm", "action": "A", "setpoint": "A", "current": "A", "gap": "m"},
        "planes": case.planes,
        "bpm_noise_rms_mm": None if np.isnan(case.stated_noise) else case.stated_noise * 1e3,
        "note": "orbit feedback, as logged",
    }
    return {
        "t": np.arange(start, stop) * case.period,
        "orbit": log.readings[rows] * 1e3,
        "action": log.actions[rows],
        "setpoint": log.setpoints[rows],
        "next_orbit": log.readings[after] * 1e3,
        "model_R": case.model * 1e3,
        "bpm_names": np.array(case.bpm_names),
        "corr_names": np.array(case.corr_names),
        "reference": case.reference[case.warm :][rows] * 1e3,
        "dither": dither[rows],
        "current": case.current[case.warm :][rows],
        "gap": case.gap[case.warm :][rows],
        "meta": np.array(json.dumps(meta)),
    }


def _truth(
    case: Conditions,
    spec: Spec,
    chosen: list[Chosen],
    ticks: int,
) -> dict[str, Any]:
    effects = []
    for start, maker, draft, size, seen in chosen:
        effects.append(
            {
                "effect": maker.id,
                "stage": maker.stage,
                "known": maker.known,
                "places": draft.places,
                "parameters": figures(draft.figures(size)),
                "onset_s": None if start <= case.warm else (start - case.warm) * case.period,
                "d_prime": seen,
                "oracle_nats": seen**2 / 2,
                "law": draft.law,
            }
        )
    return {
        "effects": effects,
        "spec": asdict(spec),
        "ticks": ticks,
        "ring": case.ring_id,
        "planes": case.planes,
        "period_s": case.period,
        "dither": case.dither_kind,
        "gain": case.gain,
        "regularisation": case.regularisation,
        "noise_m": float(case.noise.mean()),
        "noise_stated": bool(np.isfinite(case.stated_noise)),
        "ground": case.ground,
        "ground_step_m": case.ground_step,
    }


def figures(values: Mapping[str, tuple[float, str]]) -> dict[str, dict[str, Any]]:
    """Write parameters as the truth has them."""
    return {name: {"value": float(v), "unit": unit} for name, (v, unit) in values.items()}
