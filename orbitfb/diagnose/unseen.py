"""What causes without a course in time (noise, strikes) gain, and at which BPMs.

No innovation of the nominal model less that of another one shows it: it is known by stage, and its
BPMs are those that its patterns move.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.entry import Entry
from orbitfb.effects.random_kinds import LatentKind, NoiseKind


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Gains that no innovation shows.

    Args:
        by_stage: [nats over the record].
        where: Share of every BPM, shape (n,), of sum 1; None: of all alike.
    """

    by_stage: dict[str, float] = field(default_factory=dict)
    where: Vector | None = None

    @property
    def whole(self) -> float:
        """All of it [nats over the record]."""
        return sum(self.by_stage.values())

    @classmethod
    def of(cls, bench: Bench, accepted: Sequence[Entry]) -> "Unseen":
        """Add up causes.

        Args:
            bench: The record.
            accepted: Causes; those with a course in time do not count.
        """
        n = bench.record.readings.shape[1]
        stages, where = dict[str, float](), np.zeros(n)
        for entry in accepted:
            kind, gain = entry.kind, entry.candidate.gain
            if isinstance(kind, NoiseKind | LatentKind):
                stages[kind.stage] = stages.get(kind.stage, 0.0) + gain
                where += max(gain, 0.0) * _where(bench, entry)
        total = float(where.sum())
        return cls(stages, where / total if total > 0.0 else None)


def _where(bench: Bench, entry: Entry) -> Vector:
    """Share of every BPM of what a cause does, in units of their noise, shape (n,)."""
    n, kind, places = bench.record.readings.shape[1], entry.kind, list(entry.cause.places)
    seen = np.ones(n)
    if isinstance(kind, NoiseKind):
        patterns = kind.patterns(bench.record.layout)
        patterns = patterns[:, places] if places else patterns
        seen = np.sum(patterns**2, axis=1) / bench.floor.modes.spread**2
    elif places and kind.target == "bpm":
        seen = np.bincount(places, minlength=n).astype(np.float64)
    total = float(seen.sum())
    return seen / total if total > 0.0 else np.full(n, 1.0 / n)
