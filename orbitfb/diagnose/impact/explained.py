"""What every cause adds to the readings, and what is left without and with it.

Of a cause counts what is named of it, with the values that are told: the small freedom of every
device's value, by which later causes are weighed, belongs to what is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.run import Round
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.impact.waves import wave_of
from orbitfb.diagnose.verdict.named import Named
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """A record, what causes add to it, and its floor.

    Args:
        space: Of the record, all causes accepted.
        sizes: Posterior mean of every column of the errors, shape (k,).
        healthy: Spectrum of what healthy errors add, shape (T, n) [m].
        fields: Spectrum of what every cause adds, each of shape (T, n) [m]; None: only noise.
        noise: The floor.
    """

    space: Workspace
    sizes: Vector
    healthy: Matrix
    fields: tuple[Matrix | None, ...]
    noise: StepNoise

    @classmethod
    def of(
        cls, causes: Sequence[Named], accepted: Sequence[Candidate], rounds: Sequence[Round]
    ) -> "Explained":
        """Take what was accepted apart.

        Args:
            causes: In their order.
            accepted: Candidates, in the order in which they were accepted.
            rounds: Of the tournament: one before each candidate, and one behind the last.
        """
        space = rounds[-1].space
        sizes = space.errors.mean()
        usual = np.where(space.single > 0.0, 0.0, sizes)
        for block, share in zip(space.blocks, space.shares, strict=True):
            if block.accepted or share > 1.0:
                usual[block.columns] = 0.0
        added: dict[int, Matrix] = {}
        for number, part in enumerate(accepted):
            wave = wave_of(part, space)
            field = None if wave is None else wave.field
            if field is None and part.field is not None:
                field = rounds[number + 1].space.explained - rounds[number].space.explained
            columns = columns_of(part, space)
            if len(columns):
                named = np.zeros_like(sizes)
                named[columns] = sizes[columns]
                field = (0.0 if field is None else field) + space.terms.contribution(named)
            if field is not None:
                added[id(part)] = np.asarray(field)
        fields = tuple(_total([added[id(p)] for p in c.parts if id(p) in added]) for c in causes)
        return cls(space, sizes, space.terms.contribution(usual), fields, space.noise)

    @property
    def nominal(self) -> Matrix:
        """Spectrum of what the nominal model leaves, healthy errors in it, shape (T, n) [m]."""
        return self.space.plain - self.healthy

    @property
    def named(self) -> Matrix:
        """Spectrum of what all causes add, shape (T, n) [m]."""
        total = _total([one for one in self.fields if one is not None])
        return np.zeros_like(self.healthy) if total is None else total

    @property
    def left(self) -> Matrix:
        """Spectrum of what the causes leave, shape (T, n) [m]."""
        return self.nominal - self.named

    @property
    def counts(self) -> bool:
        """Whether any cause adds something that can be foretold."""
        return any(one is not None for one in self.fields)

    def over(self, noise: StepNoise) -> "Explained":
        """The same over another floor."""
        return replace(self, noise=noise)


def columns_of(part: Candidate, space: Workspace) -> Indices:
    """Columns of the errors that a candidate has for its own, shape (k,)."""
    found = list(part.columns)
    for number in part.raised:
        block = space.blocks[number].columns
        found += range(block.start, block.stop)
    return np.array(found, dtype=np.intp)


def _total(fields: Sequence[Matrix]) -> Matrix | None:
    return np.sum(fields, axis=0) if fields else None
