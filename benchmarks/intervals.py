"""Simulate every effect at drawn places and sizes, and see how often its interval has the truth.

    python -m benchmarks.intervals [--effect ID ...] [--ticks 1000] [--first 1] [--seeds 10]
        [--json FILE]

Only the effect itself is sought, beside the errors that healthy rings have: what is asked is how
well its values are told, not whether it is the right one. Values of other devices than those that
were struck do not count. Sizes are those of `benchmarks.recover` times a factor from 0.7 to 1.5.
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.blind.figures import wilson
from benchmarks.recover import SCREENED, Case, columns_of, draw, record_of
from benchmarks.small_ring import small_ring
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects
from orbitfb.physics.effect import generator
from orbitfb.physics.places import Ring
from orbitfb.records.layout import Layout

_NINETY = 1.645
"""Standard deviations of a normal number that hold nine of ten."""

_LOST = 1e-2
"""Readings at which no beam is left [m]: the loop ran away."""

DRAWN = ("bpm-row", "corrector-column", "optics-drift")
"""Effects whose size is that of numbers that are drawn: what a record has is another one."""


@dataclass(frozen=True, slots=True)
class Told:
    """A value that was told.

    Args:
        effect: Id of the effect.
        parameter: Of it.
        seed: Of the record.
        true: Value that was simulated.
        value: That was told.
        low: Lower end of its interval; None: it has none.
        high: Upper end.
    """

    effect: str
    parameter: str
    seed: int
    true: float
    value: float
    low: float | None
    high: float | None

    @property
    def inside(self) -> bool:
        """Whether the interval has the truth."""
        return self.low is not None and self.high is not None and self.low <= self.true <= self.high

    @property
    def spread(self) -> float:
        """Standard deviation that the interval stands for."""
        return ((self.high or 0.0) - (self.low or 0.0)) / (2.0 * _NINETY)


def sized(case: Case) -> Case:
    """Draw the size of a case anew: from 0.7 to 1.5 of that of the table."""
    rng = generator(case.seed, f"size of {case.kind.id}")
    factor = float(rng.uniform(0.7, 1.5))
    names = {parameter.name for parameter in case.kind.sizes}
    values = {name: v * (factor if name in names else 1.0) for name, v in case.values.items()}
    return replace(case, values=values)


def told(case: Case, ticks: int) -> Iterator[Told]:
    """Tell the values of a case; nothing where the effect is not named, or at another device."""
    record = record_of(case, ticks)
    if not np.abs(record.readings).max() < _LOST:
        return
    known = all_effects()
    others = {
        name for name, kind in known.items()
        if name != case.kind.id and kind.healthy_scatter(record.layout) is None
    }  # fmt: skip
    answer = diagnose(
        record, seed=case.seed, without=frozenset(others), progress=lambda what, share: None
    )
    for cause in answer.causes[:1]:
        if cause.effect != case.kind.id or not _there(case, cause.places, record.layout):
            continue
        for name, value in case.values.items():
            found = cause.parameters.get(name)
            if found is not None and found.value is not None:
                yield Told(
                    case.kind.id, name, case.seed, value, found.value, found.low, found.high
                )  # fmt: skip


def _there(case: Case, places: Sequence[str], layout: Layout) -> bool:
    """Whether the devices that are named were struck, and no others."""
    names = _names(case.kind, layout)
    if not case.places or names is None:
        return True
    struck = columns_of(case.kind, case.places, layout)
    return set(places) == {names[int(one)] for one in struck}


def _names(kind: EffectKind, layout: Layout) -> Sequence[str] | None:
    """Names of the devices that an effect has; None: it has places of its own."""
    devices = {"bpm": layout.bpms, "corrector": layout.correctors}.get(kind.target)
    if devices is None:
        return None
    return [devices.names[column] for column in range(len(devices))]


def row(values: Sequence[Told]) -> str:
    """Write what became of the values of a parameter in a line."""
    known = [one for one in values if one.low is not None]
    inside = sum(one.inside for one in known)
    away = np.array([(one.value - one.true) / max(one.spread, 1e-300) for one in known])
    width = [one.spread / max(abs(one.true), 1e-300) for one in known]
    figures = "no interval"
    if known:
        rms, mean = float(np.sqrt(np.mean(away**2))), float(np.mean(away))
        figures = f"rms {rms:6.2f}   mean {mean:6.2f}   width {float(np.median(width)):.3f}"
    return (
        f"{values[0].effect:22} {values[0].parameter:12} {inside:3d} of {len(known):3d}"
        f"   without {len(values) - len(known):2d}   {figures}"
    )


def cases(ids: Sequence[str], ticks: int, seeds: Sequence[int], ring: Ring) -> Iterator[Case]:
    """Draw the cases of some effects."""
    for name in ids:
        for seed in seeds:
            yield sized(draw(all_effects()[name], seed, ticks, ring))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effect", nargs="*", help="ids of effects; all by default")
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--seeds", type=int, default=10, help="seeds of each effect")
    parser.add_argument("--json", type=Path, help="file of all values")
    options = parser.parse_args()
    ring, seeds = small_ring(), range(options.first, options.first + options.seeds)
    ids = options.effect or [one for one in all_effects() if one not in (*SCREENED, *DRAWN)]
    every: list[Told] = []
    for name in ids:
        found: dict[str, list[Told]] = defaultdict(list)
        for case in cases([name], options.ticks, seeds, ring):
            for one in told(case, options.ticks):
                found[one.parameter].append(one)
                every.append(one)
        for values in found.values():
            print(row(values), flush=True)
    known = [one for one in every if one.low is not None]
    inside = sum(one.inside for one in known)
    low, high = wilson(inside, len(known))
    share = inside / max(len(known), 1)
    print(f"inside {inside} of {len(known)}: {share:.2f} [{low:.2f}, {high:.2f}], 0.90 is meant")
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(one) for one in every], indent=1))


if __name__ == "__main__":
    main()
