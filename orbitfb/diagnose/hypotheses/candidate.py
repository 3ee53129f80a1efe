"""A hypothesis with values: what it adds to the record, and what that is worth."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.hypotheses.refit import Course, joined
from orbitfb.diagnose.likelihood.corrected import driven, hearing
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import Signals
from orbitfb.estimation.priors import HEARD, VALUE_SCATTER
from orbitfb.estimation.transform import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One effect at some places with values.

    Args:
        kind: The effect.
        places: Devices or places that are struck; empty: the ring, or all of them.
        names: Of the places.
        values: Of the parameters, SI; of a law with a size per device, that of the largest one, or
            their rms if all have it.
        evidence: Log evidence over the healthy record, less the cost of places, values, onsets.
        sizes: Of every place, where each has its own, in units of the linear parameter.
        onset: Row at which it begins; 0: with the record.
        field: Spectrum of what it adds to the readings, shape (T, n) [m]; None: nothing known.
        walk: Covariance that it adds to the walk, shape (n, n) [m²].
        white: Covariance that it adds to the noise of the readings, shape (n, n) [m²].
        raised: Standard deviation of healthy errors that it raises: block number and share.
        columns: Columns of the healthy errors whose own variance it sets, with that variance.
        noisy: Whether it says something of the noise alone.
        coloured: Whether it says that the noise remembers, which no floor does.
        courseless: Whether its course is whatever the record shows at its place.
        cycles: Of a wave, from row to row [1]; None: it is none.
        sources: Courses of its devices, if any: their values stay free when it is accepted.
        drives: Tells what it adds to the currents of the correctors, shape (N, m) [A], where that
            is not in the sources; None: nothing.
        deviations: Relative standard deviations of its values, where the scan tells them; of others
            the evidence does once all causes are known.
        cost: What its log likelihood, with the best size, is more than its evidence [nats]; None:
            not known yet.
        undone: Undo it in the readings: what that takes off them, as a spectrum of shape (T, n)
            [m], and the log by which it widens their density; None: nothing undoes it.
        noise_after: Whether the noise of its BPMs comes after what they do to the orbit, which is
            then told from the orbit and not undone in the readings.
        parts: What it consists of, where several of the effect were found at once.
        after: With it, over a floor of its own; None: it was not weighed so, or another is better.
        again: The same with the sizes that it has over another floor: one that was estimated with
            the cause in it takes part of it; None: they stay.
        finer: Evaluate it exactly, and search the neighbourhood of its values, which a grid gave;
            None: that is done.
    """

    kind: EffectKind
    places: tuple[int, ...]
    names: tuple[str, ...]
    values: Mapping[str, float]
    evidence: float
    sizes: tuple[float, ...] = ()
    onset: int = 0
    field: Matrix | None = None
    walk: Matrix | None = None
    white: Matrix | None = None
    raised: Mapping[int, float] = dataclasses.field(default_factory=dict)
    columns: Mapping[int, float] = dataclasses.field(default_factory=dict)
    noisy: bool = False
    coloured: bool = False
    courseless: bool = False
    cycles: float | None = None
    sources: tuple[Course, ...] = ()
    drives: "Callable[[], Matrix] | None" = None
    deviations: Mapping[str, float] = dataclasses.field(default_factory=dict)
    cost: float | None = None
    undone: "Callable[[Workspace], tuple[Matrix, float]] | None" = None
    noise_after: bool = False
    parts: "tuple[Candidate, ...]" = ()
    after: Workspace | None = None
    again: "Callable[[Workspace], Candidate] | None" = None
    finer: "Callable[[], Candidate] | None" = None

    @property
    def scattered(self) -> bool:
        """Whether all devices have it, each of a size of its own: `values` has their rms."""
        return bool(self.raised) or (not self.places and len(self.sizes) > 1)

    @property
    def additive(self) -> bool:
        """Whether it adds a course that is told to the readings, and changes nothing else."""
        more = self.walk is not None or self.white is not None or self.raised or self.columns
        return self.field is not None and self.undone is None and not more

    @property
    def takes_noise(self) -> bool:
        """Whether its sources are undone in the readings, noise included."""
        return self._undo() is not None

    def lacks(self, signals: Signals) -> str:
        """What none of its devices shows of the law that makes it this one; empty: nothing."""
        told = [one.lacks(self.kind, signals) for one in self.sources]
        return told[0] if told and all(told) else ""

    def accepted(self, space: Workspace, spread: bool = True) -> Workspace:
        """Add it to what a workspace explains, and estimate the floor anew.

        Args:
            space: Before.
            spread: Whether its values may differ a little from device to device.
        """
        field, undo = self.field, self.undone or self._undo()
        if undo is not None:
            exact, widened = undo(space)
            if np.isfinite(exact).all() and np.isfinite(widened):
                field = exact
                added = space.transform.summed(field)
                space = replace(hearing(space, added), widened=space.widened + widened)
        elif field is not None and self.sources and self.kind.target == "bpm":
            space, field = self._heard(space)
        if field is not None:
            space = space.explaining(field)
        if self.walk is not None:
            noise = replace(space.noise, walk=space.noise.walk + self.walk)
            space = replace(space, held=space.held + self.walk, noise=noise)
        if self.white is not None:
            known = self.white if space.noise.shaken is None else space.noise.shaken + self.white
            noise = replace(space.noise, white=space.noise.white + self.white, shaken=known)
            space = replace(space, noise=noise)
        if self.raised:
            shares = list(space.shares)
            for block, share in self.raised.items():
                shares[block] = share
            space = replace(space, shares=tuple(shares))
        if self.columns:
            single = space.single.copy()
            for column, variance in self.columns.items():
                single[column] = variance
            space = replace(space, single=single)
        signals = space.signals  # currents that have the cause already have nothing of it left
        if undo is None:
            space = self.driving(space)
        # What devices have of their own was free of each other, and stays so with `again`.
        apart = self.again is not None and len(self.sources) > 1
        columns = [
            (number, column)
            for number, one in enumerate(self.sources if spread and not apart else ())
            if not one.elements
            for column in one.columns(self.kind, signals)
        ]
        if columns:
            free = tuple((number, name) for number, (name, its, _) in columns for _ in its.T)
            whole = joined([column for _, column in columns])
            space = space.beside(self.kind, self.sources[0].law, *whole, free, VALUE_SCATTER)
        return space.with_floor()

    def driving(self, space: Workspace) -> Workspace:
        """Let the healthy errors follow the currents that its correctors have."""
        signals = space.signals
        response = signals.record.layout.response
        currents, kept = signals.currents.copy(), np.zeros(len(space.terms), dtype=bool)
        if self.drives is not None:
            currents += self.drives()
        for one in self.sources:
            if one.law.patterns[0] is response:
                chosen = list(one.places) if one.places else slice(None)
                currents[:, chosen] += one.of(signals, one.values)[0] * one.size
        kept[list(self.columns)] = True
        for number in self.raised:
            kept[space.blocks[number].columns] = True
        for block in space.blocks if kept.any() else ():
            if block.law.patterns[0] is response and not block.accepted:
                sizes = np.where(kept, space.priors.mean(space.errors.pull), 0.0)[block.columns]
                currents += sizes * block.unit(signals)[0]
        moved = not np.array_equal(currents, signals.currents)
        return driven(space, currents, kept) if moved else space

    def _undo(self) -> "Callable[[Workspace], tuple[Matrix, float]] | None":
        """How its sources are undone in the readings; None: they are not."""
        heard = self.noise_after or not self.sources
        if heard or any(one.law.undone is None for one in self.sources):
            return None

        def undo(space: Workspace) -> tuple[Matrix, float]:
            record = space.signals.record
            added, widened = np.zeros_like(record.readings), 0.0
            for one in self.sources:
                for columns, change, wider in one.undone(self.kind, space.signals):
                    added[:, columns] += change
                    widened += float(np.sum(wider[~record.starts]))
            return space.transform.spectrum(added), widened

        return undo

    def _heard(self, space: Workspace) -> tuple[Workspace, Matrix]:
        """Tell what BPMs make of the orbit that is left when what they make of it is taken off.

        Where the orbit stood in the first row is known only from what they make of it there.
        """

        def sensed() -> Matrix:
            return np.sum([one.added(space.signals) for one in self.sources], axis=0)

        for _ in range(HEARD):
            space = hearing(space, sensed())
        return space, space.transform.spectrum(sensed())

    def describe(self) -> str:
        """Write it in a line, for logs and tests."""
        where = "all" if not self.places else f"{len(self.places)}:{','.join(self.names[:4])}"
        told = " ".join(f"{name}={value:.3g}" for name, value in self.values.items())
        late = f" from row {self.onset}" if self.onset else ""
        return f"{self.evidence:9.1f} {self.kind.id} {where} {told}{late}"


def strongest(candidates: "list[Candidate]") -> "list[Candidate]":
    """Sort by evidence, the best first."""
    return sorted(candidates, key=lambda one: -one.evidence)
