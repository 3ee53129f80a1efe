"""Simulate every effect at drawn places and sizes, and see how often its interval has the truth.

    python -m benchmarks.intervals [--effect ID ...] [--ticks 1000] [--seeds 10] [--json FILE]

Only the effect itself is sought: what is asked is how well its values are told, not whether it is
the right one. Sizes are those of `benchmarks.recover` times a factor from 0.7 to 1.5.
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.blind.figures import wilson
from benchmarks.recover import SCREENED, Case, draw, record_of
from benchmarks.small_ring import small_ring
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.effects.registry import all_effects
from orbitfb.physics.effect import generator

_NINETY = 1.645
"""Standard deviations of a normal number that hold nine of ten."""


@dataclass(frozen=True, slots=True)
class Told:
    """A value that was told.

    Args:
        effect: Id of the effect.
        parameter: Of it.
        seed: Of the record.
        true: Value that was simulated.
        value: That was told.
        low: Lower end of its interval.
        high: Upper end.
    """

    effect: str
    parameter: str
    seed: int
    true: float
    value: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the interval has the truth."""
        return self.low <= self.true <= self.high

    @property
    def away(self) -> float:
        """Standard deviations between value and truth."""
        return (self.value - self.true) / max((self.high - self.low) / (2.0 * _NINETY), 1e-300)


def sized(case: Case) -> Case:
    """Draw the size of a case anew: from 0.7 to 1.5 of that of the table."""
    rng = generator(case.seed, f"size of {case.kind.id}")
    factor = float(rng.uniform(0.7, 1.5))
    names = {parameter.name for parameter in case.kind.sizes}
    values = {name: v * (factor if name in names else 1.0) for name, v in case.values.items()}
    return replace(case, values=values)


def told(case: Case, ticks: int) -> Iterator[Told]:
    """Tell values that a diagnosis has intervals of; nothing where it does not name the effect."""
    known = all_effects()
    others = frozenset(known) - {case.kind.id}
    answer = diagnose(
        record_of(case, ticks), seed=case.seed, without=others, progress=lambda what, share: None
    )
    for cause in answer.causes[:1]:
        for name, value in case.values.items():
            found = cause.parameters.get(name)
            if found is None or found.low is None or found.high is None:
                continue
            yield Told(
                case.kind.id, name, case.seed, value, found.value, found.low, found.high
            )  # fmt: skip


def row(values: Sequence[Told]) -> str:
    """Write what became of the values of a parameter in a line."""
    inside = sum(one.inside for one in values)
    away = np.array([one.away for one in values])
    width = [(one.high - one.low) / (2.0 * _NINETY * max(abs(one.true), 1e-300)) for one in values]
    rms = float(np.sqrt(np.mean(away**2)))
    return (
        f"{values[0].effect:22} {values[0].parameter:12} {inside:3d} of {len(values):3d}   "
        f"rms {rms:6.2f}   mean {np.mean(away):6.2f}   width {float(np.median(width)):.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effect", nargs="*", help="ids of effects; all by default")
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--json", type=Path, help="file of all values")
    options = parser.parse_args()
    ring = small_ring()
    ids = options.effect or [one for one in all_effects() if one not in SCREENED]
    every: list[Told] = []
    for name in ids:
        found: dict[str, list[Told]] = defaultdict(list)
        for seed in range(1, options.seeds + 1):
            case = sized(draw(all_effects()[name], seed, options.ticks, ring))
            for one in told(case, options.ticks) if np.isfinite(record_of(case, options.ticks).readings).all() else ():
                found[one.parameter].append(one)
                every.append(one)
        for values in found.values():
            print(row(values), flush=True)
    inside = sum(one.inside for one in every)
    low, high = wilson(inside, len(every))
    print(f"inside: {inside} of {len(every)}, {inside / max(len(every), 1):.2f} [{low:.2f}, {high:.2f}]")
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(one) for one in every], indent=1))


if __name__ == "__main__":
    main()
