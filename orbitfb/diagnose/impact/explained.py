"""What every cause adds to the readings, and what is left without and with it.

Of a cause counts what is named of it, with the values that are told. The values of its devices stay
free while later causes are weighed: where the record shows that they differ, the differences are
told and count; where it does not, that small freedom belongs to what is left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.impact.pieces import Differences, Piece, columns_of, pieces_of
from orbitfb.diagnose.impact.waves import wave_of
from orbitfb.diagnose.likelihood.errors import ErrorBlock, saturated
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import Round
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import LEAST_SHARE, WIDE
from orbitfb.estimation.transform import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """A record, what causes add to it, and its floor.

    Args:
        space: Of the record, all causes accepted.
        sizes: Posterior mean of every column of the errors, shape (k,).
        healthy: Spectrum of what healthy errors add, shape (T, n) [m].
        loose: Spectrum of what the freedom of the causes' values adds, untold, shape (T, n) [m].
        fields: Spectrum of what every cause adds, each of shape (T, n) [m]; None: only noise.
        pieces: Values of the devices of every part of every cause.
        differences: Of the devices of every candidate's sources, by the candidate's identity.
        noise: The floor.
    """

    space: Workspace
    sizes: Vector
    healthy: Matrix
    loose: Matrix
    fields: tuple[Matrix | None, ...]
    pieces: tuple[tuple[tuple[Piece, ...], ...], ...]
    differences: Mapping[int, Mapping[int, Differences]]
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
        bend = space.bend_of(usual)
        healthy = space.terms.contribution(usual) + bend
        taken = _Taken(space, sizes, usual, bend)
        for number, part in enumerate(accepted):
            wave = wave_of(part, space)
            own = None if wave is None else wave.field
            if own is None and part.field is not None:
                own = rounds[number + 1].space.explained - rounds[number].space.explained
            taken.take(part, own)
        return cls(
            space, sizes, healthy, space.terms.contribution(taken.left()),
            tuple(taken.field_of(one) for one in causes),
            tuple(taken.pieces_of(one) for one in causes), taken.differences, space.noise,
        )  # fmt: skip

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

    @property
    def foretold(self) -> bool:
        """Whether every cause does."""
        return all(one is not None for one in self.fields)

    def over(self, noise: StepNoise) -> "Explained":
        """The same over another floor."""
        return replace(self, noise=noise)

    def fitted_shares(self) -> tuple[float, float]:
        """Shares of all readings that the saturated model, and the healthy errors, have fitted [1].

        A model with as many degrees of freedom takes this share of the noise with it.
        """
        space = self.space.knowing_all()
        wide = np.maximum(saturated(space.blocks, len(space.terms), WIDE), space.single)
        count = float(self.healthy.size)
        return (
            _degrees(space.known.information, wide) / count,
            _degrees(space.known.information, space.variance) / count,
        )


@dataclass(slots=True, eq=False)
class _Taken:
    """Fields and pieces of candidates, taken in the order in which they were accepted.

    Args:
        space: Of the record, all causes accepted.
        sizes: Of every column of the errors, shape (k,).
        known: The same of those that are healthy or were taken; the others are zero.
        bend: Spectrum of what these add together, beyond the sum of each alone, (T, n) [m].
    """

    space: Workspace
    sizes: Vector
    known: Vector
    bend: Matrix
    fields: dict[int, Matrix] = field(default_factory=dict)
    pieces: dict[int, tuple[Piece, ...]] = field(default_factory=dict)
    differences: dict[int, Mapping[int, Differences]] = field(default_factory=dict)
    told: list[ErrorBlock] = field(default_factory=list)

    def take(self, part: Candidate, own: Matrix | None) -> None:
        """Take a candidate, with the field that it has for itself."""
        space = self.space
        named = np.zeros_like(self.sizes)
        columns = columns_of(part, space)
        named[columns] = self.sizes[columns]
        differences: Mapping[int, Differences] = {}
        block = self._block(part)
        if block is not None and self._differ(block):
            differences = part_differences(part, block, self.sizes[block.columns])
            if differences:
                named[block.columns] = self.sizes[block.columns]
                self.told.append(block)
        if len(columns):
            self.known = self.known + named
            bend = space.bend_of(self.known)
            own, self.bend = (0.0 if own is None else own) + bend - self.bend, bend
        if np.any(named):
            own = (0.0 if own is None else own) + space.terms.contribution(named)
        if own is not None:
            self.fields[id(part)] = np.asarray(own)
        self.differences[id(part)] = differences
        self.pieces[id(part)] = pieces_of(part, space, self.sizes, differences)

    def _block(self, part: Candidate) -> ErrorBlock | None:
        """Columns of a candidate's free values: blocks stand in the order of acceptance."""
        if not part.sources:
            return None
        law = part.sources[0].law
        own = [one for one in self.space.blocks if one.accepted and one.law is law]
        own = [one for one in own if not any(one is told for told in self.told)]
        return own[0] if own else None

    def _differ(self, block: ErrorBlock) -> bool:
        """Whether the record shows that the values of devices differ."""
        number = next(i for i, one in enumerate(self.space.blocks) if one is block)
        return self.space.shares[number] > LEAST_SHARE

    def left(self) -> Vector:
        """Sizes of the free values that are not told, shape (k,)."""
        loose = np.zeros_like(self.sizes)
        for block in self.space.blocks:
            if block.accepted and not any(block is told for told in self.told):
                loose[block.columns] = self.sizes[block.columns]
        return loose

    def field_of(self, cause: Named) -> Matrix | None:
        """What all parts of a cause add."""
        return _total([self.fields[id(p)] for p in cause.parts if id(p) in self.fields])

    def pieces_of(self, cause: Named) -> tuple[tuple[Piece, ...], ...]:
        """Values of all devices of a cause, by its parts."""
        return tuple(self.pieces[id(part)] for part in cause.parts)


def part_differences(
    part: Candidate, block: ErrorBlock, sizes: Vector
) -> Mapping[int, Differences]:
    """Relative differences of values, by number of the source, parameter and device.

    Empty where a device has several columns of one parameter, one per plane: it has one value.

    Args:
        part: A candidate with courses.
        block: Its columns.
        sizes: Of them, in their order, shape (k,).
    """
    found: dict[int, dict[str, Vector]] = {}
    for key in dict.fromkeys(block.free):
        number, name = key
        own = sizes[[one == key for one in block.free]]
        source = part.sources[number]
        if len(own) > (len(source.places) or len(source.law.names)):
            return {}
        found.setdefault(number, {})[name] = own
    return found


def _degrees(information: Matrix, variance: Vector) -> float:
    """Degrees of freedom of terms with a prior: the trace of (Λ⁻¹ + G)⁻¹ G."""
    used = np.flatnonzero(variance > 0.0)
    if not len(used):
        return 0.0
    scale = np.sqrt(variance[used])
    inner = scale[:, None] * information[np.ix_(used, used)] * scale
    inner[np.diag_indices_from(inner)] += 1.0
    inverse = cho_solve(cho_factor(inner, lower=True), np.eye(len(used)))
    return float(len(used) - np.trace(inverse))


def _total(fields: Sequence[Matrix]) -> Matrix | None:
    return np.sum(fields, axis=0) if fields else None
