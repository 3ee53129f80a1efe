"""Small errors that any ring has: variance components whose sizes the record tells."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.likelihood.terms import Terms
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.priors import LIMITS, SHARES
from orbitfb.estimation.transform import Matrix, StepTransform


@dataclass(frozen=True, slots=True)
class ErrorBlock:
    """The columns of one healthy error.

    Args:
        kind: Its effect.
        law: Of the effect.
        pattern: Which of its law's blocks of patterns the columns have.
        columns: Among the terms: one per device.
        delayed: Further columns, the same courses some rows late, less the course itself.
        limit: Standard deviation up to which a healthy ring has it, by device, shape (D,).
        free: Of deviations of a cause that was accepted: number of the source and parameter of
            every column; empty of a healthy error.
    """

    kind: EffectKind
    law: DeviceLaw
    pattern: int
    columns: slice
    delayed: slice
    limit: Vector
    free: tuple[tuple[int, str], ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether these are deviations of a cause that was accepted, not healthy errors."""
        return bool(self.free)

    def of_devices(self, target: str) -> bool:
        """Whether it is an error of the devices that a target names; the ring as such has none."""
        return self.kind.target == target != "ring"

    def unit(self, signals: Signals) -> tuple[Matrix, ...]:
        """Courses of an error of one, one for every plane, shape (N, D) each."""
        return unit_courses(self.kind, self.law, signals)


def unit_courses(kind: EffectKind, law: DeviceLaw, signals: Signals) -> tuple[Matrix, ...]:
    """Courses of a law whose linear parameter is one, shape (N, D) each."""
    size = next(p.typical for p in kind.parameters if p.name == kind.linear)
    parts = law.course({p.name: p.typical for p in kind.parameters}, signals)
    return tuple(part / size for part in parts)


def healthy_errors(
    kinds: Sequence[EffectKind], signals: Signals, transform: StepTransform
) -> tuple[Terms, tuple[ErrorBlock, ...]]:
    """Lay out the columns of all errors that a healthy ring has.

    Args:
        kinds: Effects that are tested.
        signals: What they act on.
        transform: Of the record.

    Returns:
        Their terms, per unit of each effect's size, and the blocks that they form. A device that
        acts in two planes has its two columns summed in one block per plane.
    """
    patterns, pattern, courses, blocks = _laid_out(kinds, signals, transform)
    return Terms.of(patterns, pattern, courses, transform), blocks


def _laid_out(
    kinds: Sequence[EffectKind], signals: Signals, transform: StepTransform
) -> tuple[Matrix, np.ndarray, Matrix, tuple[ErrorBlock, ...]]:
    """Give patterns, which of them a column has, courses of shape (N, k), and the blocks."""
    patterns: list[Matrix] = []
    pattern: list[np.ndarray] = []
    courses: list[Matrix] = []
    blocks: list[ErrorBlock] = []
    first = known = 0
    for kind in kinds:
        limit = kind.healthy_scatter(signals.record.layout)
        if limit is None or kind.linear is None:
            continue
        law = next(one for one in kind.laws(signals) if isinstance(one, DeviceLaw))
        count = len(limit)
        units = unit_courses(kind, law, signals)
        for number, (block, unit) in enumerate(zip(law.patterns, units, strict=True)):
            if not np.any(block):
                continue
            late = [_delayed(unit, rows, transform) - unit for rows in range(1, kind.delays + 1)]
            patterns.append(block)
            pattern += [known + np.arange(count)] * (1 + kind.delays)
            courses += [unit, *late]
            own = slice(first, first + count)
            rest = slice(own.stop, own.stop + count * kind.delays)
            blocks.append(ErrorBlock(kind, law, number, own, rest, limit))
            first, known = rest.stop, known + count
    if not blocks:
        rows = signals.record.layout.response.shape[0]
        return np.zeros((rows, 0)), np.zeros(0, np.intp), np.zeros((transform.rows, 0)), ()
    return np.hstack(patterns), np.concatenate(pattern), np.hstack(courses), tuple(blocks)


def following(
    blocks: Sequence[ErrorBlock],
    signals: Signals,
    transform: StepTransform,
    terms: Terms,
    kept: Mask,
) -> Terms:
    """The same columns for other currents; those of accepted causes stay.

    Args:
        blocks: Of all columns, healthy errors first.
        signals: With the other currents.
        transform: Of the record.
        terms: The columns before.
        kept: Columns of errors that are causes: they made these currents, shape (k,).
    """
    kinds = dict.fromkeys(block.kind for block in blocks if not block.accepted)
    _, _, courses, _ = _laid_out(tuple(kinds), signals, transform)
    return terms.instead(courses, transform, kept)


def fitted_scales(
    blocks: Sequence[ErrorBlock],
    terms: NormalTerms,
    least: Sequence[float],
    begin: Sequence[float] | None = None,
) -> tuple[list[float], float]:
    """Find the share of each healthy scatter that the record shows, by evidence.

    Args:
        blocks: Of the errors.
        terms: Pull and information of all columns, and the least variance that each has.
        least: Shares that are granted already, by block; one above 1 is kept.
        begin: Shares to begin with; None: the least.

    Returns:
        Shares by block, and the log evidence with them.
    """
    shares = list(least if begin is None else np.maximum(begin, least))

    def worth(tried: Sequence[float]) -> float:
        variance = np.maximum(variances(blocks, tried, len(terms.pull)), terms.variance)
        return NormalTerms(terms.pull, terms.information, variance).evidence()

    best, moved = worth(shares), 0
    free = [place for place, given in enumerate(least) if given <= 1.0]
    for turn, place in enumerate([*free, *free]):
        if turn - moved >= len(free):
            break  # all others were tried since one moved
        for share in SHARES[1:] if blocks[place].accepted else SHARES:
            if share == shares[place]:
                continue
            tried = [*shares[:place], share, *shares[place + 1 :]]
            found = worth(tried)
            if found > best + 1e-9:
                best, shares, moved = found, tried, turn
    return shares, best


def variances(blocks: Sequence[ErrorBlock], shares: Sequence[float], count: int) -> Vector:
    """Prior variance of every column for given shares of the healthy scatter, shape (count,)."""
    variance = np.zeros(count)
    for block, share in zip(blocks, shares, strict=True):
        variance[block.columns] = (share * block.limit) ** 2
    return variance


def saturated(blocks: Sequence[ErrorBlock], count: int, times: float) -> Vector:
    """Prior variance of every column, wide enough for any linear law of any device."""
    variance = np.zeros(count)
    for block in blocks:
        own = 1.0 if block.accepted else times
        variance[block.columns] = (own * block.limit) ** 2
        copies = block.delayed.stop - block.delayed.start
        if copies:
            repeat = copies // len(block.limit)
            variance[block.delayed] = np.tile((times * block.limit) ** 2, repeat)
    return variance


def wider(
    blocks: Sequence[ErrorBlock],
    seen: Sequence[ErrorBlock],
    shares: Sequence[float],
    terms: NormalTerms,
) -> tuple[ErrorBlock, ...]:
    """Limits of healthy errors, where a healthy record shows larger ones.

    Args:
        blocks: Of another record of the same devices.
        seen: Of the healthy record.
        shares: Of its healthy scatters, by block.
        terms: Pull and information of its columns.
    """
    found: list[ErrorBlock] = []
    for number, block in enumerate(blocks):
        best, share = -np.inf, 1.0
        for tried in LIMITS:
            its = [*shares[:number], tried, *shares[number + 1 :]]
            variance = variances(seen, its, len(terms.pull))
            worth = NormalTerms(terms.pull, terms.information, variance).evidence()
            if worth > best:
                best, share = worth, tried
        found.append(replace(block, limit=share * block.limit))
    return tuple(found)


def _delayed(courses: Matrix, rows: int, transform: StepTransform) -> Matrix:
    late = courses.copy()
    for part in transform.stretches:
        late[part] = courses[np.maximum(np.arange(part.start, part.stop) - rows, part.start)]
    return late
