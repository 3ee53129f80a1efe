"""The likelihood of a record: its floor, its healthy errors, and the causes that were accepted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.likelihood.bend import added_together
from orbitfb.diagnose.likelihood.courses import Courses
from orbitfb.diagnose.likelihood.errors import (
    ErrorBlock,
    fitted_scales,
    healthy_errors,
    saturated,
    variances,
    wider,
)
from orbitfb.diagnose.likelihood.ground import ground_shapes
from orbitfb.diagnose.likelihood.known import Known
from orbitfb.diagnose.likelihood.terms import Terms
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.estimation.colour import rarity
from orbitfb.estimation.evidence import NormalPriors, NormalTerms
from orbitfb.estimation.floor import distance, first_noise, foretold, improve, trusted
from orbitfb.estimation.moments import Moments
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.prediction import predicted
from orbitfb.estimation.priors import (
    AGAIN,
    AT_FIRST,
    BENT,
    EXACTLY,
    FREELY,
    LEAST_SHARE,
    MATERIAL,
    MOST_STEPS,
    TRUST,
    TURNS,
    WIDE,
)
from orbitfb.estimation.shapes import Shapes, fit_shapes
from orbitfb.estimation.transform import Indices, Matrix, StepTransform
from orbitfb.records.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """A record with a floor, healthy errors and what has been explained so far.

    Args:
        signals: The record, the currents and the predicted orbit.
        transform: Of its steps.
        plain: Spectrum of the readings less the nominal model, shape (T, n) [m].
        explained: Spectrum of what accepted causes add, shape (T, n) [m].
        bend: Spectrum of what errors add together, beyond the sum of each alone, (T, n) [m].
        refinement: Spectrum of what the table of places says beyond the linear model, (T, n) [m].
        noise: The floor.
        shape: Prior mean of the walk's covariance, shape (n, n) [m²].
        held: Covariance of the walk that accepted random causes own, shape (n, n) [m²].
        terms: Columns of the healthy errors.
        blocks: Which columns are whose.
        known: What a floor says of the columns.
        shares: Of each healthy scatter, by block; above 1 where a cause raised it.
        single: Prior variances of single columns that a cause raised, shape (k,).
        courses: Of the laws.
        ground: Shapes that the walk may have.
        weights: Of them in the walk, shape (F,); empty before the first fit.
        reference: Of a healthy time, whose walk is the prior of this one's; None: there is none.
        trust: Steps that the prior mean of the walk is worth; zero: the next floor tells;
            infinite: the ground is even, and the walk has no other shape.
        bending: Share of `bend` in what errors of these sizes should add together.
        refining: Share of it that the record shows.
        widened: Log of the factor by which undoing accepted causes widens the readings' density.
        asked: The healthy errors and their factored priors, once they were asked for.
        uneven: What uneven ground foretells, once it was asked for.
    """

    signals: Signals
    transform: StepTransform
    plain: Matrix
    explained: Matrix
    bend: Matrix
    refinement: Matrix
    noise: StepNoise
    shape: Matrix
    held: Matrix
    terms: Terms
    blocks: tuple[ErrorBlock, ...]
    known: Known
    shares: tuple[float, ...]
    single: Vector
    courses: Courses
    ground: Shapes
    weights: Vector
    reference: "Workspace | None" = None
    trust: float = 0.0
    bending: float = 0.0
    refining: float = 0.0
    widened: float = 0.0
    asked: list[tuple[NormalTerms, NormalPriors]] = field(default_factory=list, init=False)
    uneven: list[float] = field(default_factory=list, init=False)

    @classmethod
    def of(
        cls,
        record: Record,
        kinds: Sequence[EffectKind],
        *,
        bands: int | None = 16,
        exact: bool = False,
        reference: "Workspace | None" = None,
    ) -> "Workspace":
        """Estimate the floor of a record.

        Args:
            record: In question.
            kinds: Effects that are tested: those that healthy rings have become errors.
            bands: Of λ; None: as many as there are values of λ.
            exact: Transform whole stretches.
            reference: Of a healthy time of the same devices: its walk is what the walk of this
                record is compared with, and errors that it has are healthy ones.

        Raises:
            EstimationError: The record is too short, or does not move.
        """
        transform = StepTransform.of(record.starts, bands, exact)
        ground = ground_shapes(record.layout)
        space = cls.begun(record, kinds, transform, ground)
        noise, moments = space.noise, Moments.of(space.plain, transform)
        first, weights = fit_shapes(noise, moments, ground, space.held, rounds=AGAIN)
        space = replace(space, noise=first, known=Known.nothing(first), weights=weights)
        if reference is not None:
            blocks = wider(space.blocks, reference.blocks, reference.shares, reference.errors)
            worth = float(len(reference.transform))
            space = replace(space, blocks=blocks, reference=reference, trust=worth)
        return space.refinable(kinds).with_floor(AT_FIRST).with_floor()

    @classmethod
    def begun(
        cls,
        record: Record,
        kinds: Sequence[EffectKind],
        transform: StepTransform,
        ground: Shapes,
    ) -> "Workspace":
        """Lay out a record with the first noise that its steps show, and without any error.

        Args:
            record: In question.
            kinds: Effects that are tested.
            transform: Of its steps.
            ground: Shapes that the walk may have.

        Raises:
            EstimationError: The record is too short, or does not move.
        """
        modelled = record.setpoints @ record.layout.response.T
        residual = record.readings - modelled
        noise = first_noise(transform.steps(residual), ground.broad[0])
        layout = record.layout
        plane = np.array([layout.planes.index(one) for one in layout.bpms.planes], dtype=np.intp)
        colour = np.repeat(noise.colour, len(layout.planes), axis=0)
        noise = replace(noise, plane=plane, colour=colour)
        orbit = predicted(residual, noise, transform) + modelled
        signals = Signals(record, record.setpoints, orbit)
        terms, blocks = healthy_errors(kinds, signals, transform)
        plain = transform.spectrum(residual)
        return cls(
            signals,
            transform,
            plain,
            explained=np.zeros_like(plain),
            bend=np.zeros_like(plain),
            refinement=np.zeros_like(plain),
            noise=noise,
            shape=noise.walk,
            held=np.zeros_like(noise.walk),
            terms=terms,
            blocks=blocks,
            known=Known.nothing(noise),
            shares=(0.0,) * len(blocks),
            single=np.zeros(len(terms)),
            courses=Courses(signals, transform),
            ground=ground,
            weights=np.zeros(0),
        )

    def refinable(self, kinds: Sequence[EffectKind]) -> "Workspace":
        """Take what the table of places says beyond the linear model for a part of the model.

        One that is large enough to be named is left to be found.
        """
        found = np.zeros_like(self.plain)
        scale = float(np.sqrt(np.mean(np.diag(self.noise.white))))
        for kind in kinds:
            course = kind.refinement(self.signals)
            if course is None:
                continue
            field = self.transform.spectrum(course)
            if float(np.sqrt(np.mean(field**2))) < MATERIAL * scale:
                found += field
        return replace(self, refinement=found)

    def refined(self) -> "Workspace":
        """Tell how much of the refinement the record shows, beside errors and causes."""
        share = self._shown(self.refinement, self.refining * self.refinement)
        return self if share is None else replace(self, refining=share)

    def bent(self) -> "Workspace":
        """Tell what the errors add together, of the sizes that they have now, if that has moved.

        Errors that stand in for a cause that is not known yet add nothing of the kind.
        """
        whole = self._together(self.priors.mean(self.errors.pull))
        share = self._shown(whole, self.bend)
        return self if share is None else replace(self, bend=share * whole, bending=share)

    def _shown(self, whole: Matrix, now: Matrix) -> float | None:
        """Share of a field that the record shows beside errors, between nothing and all.

        Args:
            whole: The field, shape (T, n) [m].
            now: What the residual is already without, shape (T, n) [m].

        Returns:
            The share [1]; None: nothing that matters would change.
        """
        pulled = self.noise.pull(whole, self.transform)
        square = float(np.sum(pulled * whole))
        if square < BENT:
            return None
        sizes = self.priors.mean(self.errors.pull)
        cross = self.terms.pull(pulled, self.variance > 0.0)
        beyond = square - float(cross @ self.priors.mean(cross))
        more = (float(np.sum(pulled * self.residual)) - float(cross @ sizes)) / beyond
        share = float(np.clip(np.sum(pulled * now) / square + more, 0.0, 1.0))
        moved = share * whole - now
        if 0.5 * float(np.sum(self.noise.pull(moved, self.transform) * moved)) < BENT:
            return None
        return share

    def bend_of(self, sizes: Vector) -> Matrix:
        """What errors of other sizes add together, shape (T, n) [m]; of `sizes`, shape (k,)."""
        return self.bending * self._together(sizes) if self.bending else np.zeros_like(self.bend)

    def _together(self, sizes: Vector) -> Matrix:
        driving = self.single > 0.0  # what is a cause is in the currents already
        for block, share in zip(self.blocks, self.shares, strict=True):
            driving[block.columns] |= share > 1.0
        known = self.blocks, sizes, driving, self.terms
        return added_together(*known, self.signals, self.transform)

    @property
    def residual(self) -> Matrix:
        """What the model and the accepted causes leave, shape (T, n) [m]."""
        return self.plain - self.explained - self.bend - self.refining * self.refinement

    @property
    def left(self) -> Matrix:
        """What the healthy errors leave of it besides, shape (T, n) [m]."""
        return self.residual - self.terms.contribution(self.priors.mean(self.errors.pull))

    @property
    def variance(self) -> Vector:
        """Prior variance of every column now."""
        usual = variances(self.blocks, self.shares, len(self.terms))
        return np.maximum(usual, self.single)

    @property
    def errors(self) -> NormalTerms:
        """The healthy errors under the floor, as the residual pulls at them."""
        return self._asked()[0]

    @property
    def priors(self) -> NormalPriors:
        """The same, factored."""
        return self._asked()[1]

    def _asked(self) -> tuple[NormalTerms, NormalPriors]:
        if not self.asked:
            its = NormalPriors.of(self.known.information, self.variance)
            # The pull is that which makes the mean right to the last frequency agree with an
            # information by band.
            pull, mean, informed = self._fitted(its)
            agreeing = pull - informed(mean) + self.known.information @ mean
            self.asked.append((NormalTerms(agreeing, self.known.information, self.variance), its))
        return self.asked[0]

    def _fitted(self, its: NormalPriors) -> tuple[Vector, Vector, Callable[[Vector], Vector]]:
        """Pull of the columns, their mean to the last frequency, and what sizes take of the pull.

        Args:
            its: Priors of the columns, factored with their information by band.
        """
        seen = (self.noise.modes.T @ self.terms.patterns).astype(np.float32)
        weigh = self.noise.variance(self.transform).astype(np.float32)

        def informed(sizes: Vector) -> Vector:
            return self.terms.applied(sizes, seen, weigh, self.known.columns)

        weighed = (self.residual @ self.noise.modes).astype(np.float32) / weigh
        pull = self.terms.pull(weighed, self.known.columns, seen)
        return pull, its.exact_mean(pull, informed, EXACTLY, MOST_STEPS), informed

    def with_floor(self, rounds: int = AGAIN) -> "Workspace":
        """Estimate the floor anew, on what a saturated linear model leaves; then the errors.

        Args:
            rounds: In which the shapes of the walk are fitted, at most.
        """
        full = self.saturable()
        left, scatter = full.beyond()
        moments = Moments.of(left, self.transform).beside(scatter)
        mixed, weights = self.noise, self.weights
        # What a loop without dither answers to its ground is hardly told from other ground: its
        # colour is that of what the model leaves, not of what a saturated one does.
        coloured = bool(np.any(mixed.colour))
        turns = TURNS if coloured else 1
        for _ in range(turns):
            if coloured:
                levels, mixed = mixed.recoloured(full.left, self.transform)
                weights = self.shapes.scaled(weights, levels)
            mixed, weights = fit_shapes(
                mixed, moments, self.shapes, self.held, weights, rounds=rounds // turns
            )
        shape = mixed.walk - self.held
        if self.reference is not None:
            shape = self.reference.noise.walk
            mixed = replace(mixed, walk=shape + self.held)
        trust = self.trust
        if not trust:
            trust = trusted(mixed, Moments.halves(left, self.transform, scatter), TRUST)
        noise = improve(mixed, moments, mixed.walk, FREELY, trust)
        fresh = replace(self, noise=noise, shape=shape, weights=weights, trust=trust)
        return fresh._knowing(self._own).with_errors().refined().bent()

    def with_noise(self, noise: StepNoise) -> "Workspace":
        """Take another floor to begin with."""
        return replace(self, noise=noise)._knowing(self._own)

    def unmodelled(self) -> tuple[Matrix, Matrix]:
        """What a saturated linear model leaves, (T, n) [m], and its own scatter, (B, n, n) [m²]."""
        return self.saturable().beyond()

    def beyond(self) -> tuple[Matrix, Matrix]:
        """The same of one that knows already what a saturated model takes (`saturable`)."""
        free = self.known.saturated
        _, mean, _ = self._fitted(free.priors)
        return self.residual - self.terms.contribution(mean), free.scatter

    def trusting(self) -> "Workspace":
        """Let the next floor tell what its prior is worth, now that more is known."""
        given = self.reference is not None or self.is_even
        return self if given else replace(self, trust=0.0)

    def even(self) -> "Workspace":
        """The same over even ground: all bodies of a kind move alike, and nothing else moves."""
        weights = self.weights[: len(self.ground.even)]
        even = replace(self, weights=weights, trust=np.inf)
        return even.with_floor(AT_FIRST).with_floor()

    @property
    def is_even(self) -> bool:
        """Whether the ground is taken to be even."""
        return bool(np.isinf(self.trust))

    @property
    def shapes(self) -> Shapes:
        """Those of the ground that the walk has."""
        return self.ground.even if self.is_even else self.ground

    def unevenness(self) -> float:
        """What ground that is not even foretells beyond ground that is [nats].

        So much does a cause that is found over even ground owe: one body may move more than others,
        and to say which is as much as to say where a cause is. Over other ground nothing is owed.
        """
        if not self.is_even:
            return 0.0
        if not self.uneven:
            halves = Moments.halves(self.left, self.transform)
            even = self.weights[: len(self.ground.even)]
            bodies = len(self.ground) - len(even)
            weights = np.concatenate([even, np.zeros(bodies)])
            known, choices = (self.noise, halves), (np.inf, *TRUST)
            plain, *shaped = foretold(*known, self.ground.even, self.held, even, choices)
            freely = foretold(*known, self.ground, self.held, weights, choices)
            owed = max(*shaped, *freely) - plain - float(np.log(max(bodies, 1)))
            self.uneven.append(max(0.0, owed))
        return self.uneven[0]

    def knowing_all(self) -> "Workspace":
        """Know the information of all columns, those of a saturated model too."""
        return self._knowing(np.ones(len(self.terms), dtype=bool))

    def saturable(self) -> "Workspace":
        """Know what a saturated model takes of the floor."""
        space = self.knowing_all()
        wide = np.maximum(saturated(space.blocks, len(space.terms), WIDE), space.single)
        return replace(space, known=space.known.beside(space.terms, wide))

    @property
    def _own(self) -> Mask:
        """Columns that may have a size in a model that is not saturated, shape (k,)."""
        own = np.ones(len(self.terms), dtype=bool)
        for block in self.blocks:
            own[block.delayed] = False
        return own

    def _knowing(self, wanted: Mask) -> "Workspace":
        """Know the information of some columns under the floor now."""
        known = self.known.of(self.noise, self.terms, self.transform, wanted)
        return replace(self, known=known)

    def with_errors(self) -> "Workspace":
        """Fit the sizes of the healthy errors, within their limits."""
        given = [
            share if share > 1.0 else LEAST_SHARE if block.accepted else 0.0
            for share, block in zip(self.shares, self.blocks, strict=True)
        ]
        terms = replace(self.errors, variance=self.single)
        shares, _ = fitted_scales(self.blocks, terms, given, self.shares)
        return replace(self, shares=tuple(shares))

    def explaining(self, spectrum: Matrix) -> "Workspace":
        """Accept what a cause adds to the readings."""
        return replace(self, explained=self.explained + spectrum)

    def beside(
        self,
        kind: EffectKind,
        law: DeviceLaw,
        patterns: Matrix,
        pattern: Indices,
        courses: Matrix,
        free: tuple[tuple[int, str], ...],
        limit: float,
    ) -> "Workspace":
        """Let the values of an accepted cause differ a little from device to device.

        Args:
            kind: Of the cause.
            law: Of it.
            patterns: Of the columns, shape (n, P) [m].
            pattern: Which of them a column has, shape (k,).
            courses: Of the columns, shape (N, k).
            free: Number of the source and parameter of every column.
            limit: Largest standard deviation of their sizes.
        """
        terms = self.terms.beside(patterns, pattern, courses, self.transform)
        count = len(pattern)
        columns = slice(len(self.terms), len(terms))
        none = slice(len(terms), len(terms))
        block = ErrorBlock(kind, law, 0, columns, none, np.full(count, limit), free)
        return replace(
            self,
            terms=terms,
            blocks=(*self.blocks, block),
            shares=(*self.shares, LEAST_SHARE),
            single=np.concatenate([self.single, np.zeros(count)]),
        )

    def log_likelihood(self) -> float:
        """Log density of the readings, healthy errors marginalised."""
        mean = self.priors.mean(self.errors.pull)
        left = self.residual - self.terms.contribution(mean)
        plain = self.noise.log_likelihood(left, self.transform)
        return plain + self.priors.log_density(mean) + self.widened

    def log_posterior(self) -> float:
        """The same with what its distance from its prior takes off the floor.

        Spaces whose floors were estimated each for itself are compared by it: a floor that stands
        in for what a cause does is far from what ground makes, or makes much of one place.
        """
        apart = 0.0  # over even ground the walk has no other shape
        if not self.is_even:
            apart = 0.5 * self.trust * distance(self.noise.walk, self.shape + self.held)
        uneven = 0.0 if self.reference is not None else self.shapes.cost(self.weights)
        return self.log_likelihood() - apart - uneven - rarity(self.noise.colour)
