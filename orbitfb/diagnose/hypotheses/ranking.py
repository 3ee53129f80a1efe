"""Values of a law's grid, ranked by what they explain of the residual."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import Worth
from orbitfb.effects.kinds import EffectKind, OwnValues, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import best_size, given_size, normal_size
from orbitfb.estimation.priors import (
    GRID_REACH,
    HOPE,
    ONSET_SIGN,
    RANKED_VALUES,
    SIZE_WIDTH,
    STOOD_IN,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Ranked:
    """A grid of values, ranked.

    Args:
        grid: The values, one for all devices.
        own: Values of every device's own, each parameter a number or of shape (D,).
        alone: Log evidence of every device for itself, of the grid and then of `own`, (V, D).
        promising: The values that explain most, by device, by group and by all devices together:
            where some devices are struck, a single one stands for the others with another value.
        beginning: Those of which most shows of any size, of the grid and of each device's own: what
            begins late has part of it.
    """

    grid: Sequence[Values]
    own: Sequence[OwnValues]
    alone: Matrix
    promising: list[Values]
    beginning: list[OwnValues]

    def values(self, number: int, device: int) -> Values:
        """Values number `number` as device `device` has them."""
        if number < len(self.grid):
            return self.grid[number]
        return of_device(self.own[number - len(self.grid)], device)

    def around(self, values: Values, places: Sequence[int]) -> tuple[str, float, float] | None:
        """The value that runs over the grid, and the ends between which to search it.

        Args:
            values: At which the search begins.
            places: Devices that have it; of a single one its own values count, too.

        Returns:
            Its name and the ends; None: the grid has one value.
        """
        name = running(self.grid)
        if name is None:
            return None
        own = [of_device(one, places[0]) for one in self.own] if len(places) == 1 else []
        line = np.unique([values[name], *(one[name] for one in (*self.grid, *own))])
        place, last = int(np.searchsorted(line, values[name])), len(line) - 1
        ends = max(place - GRID_REACH, 0), min(place + GRID_REACH, last)
        return name, float(line[ends[0]]), float(line[ends[1]])


def of_device(values: OwnValues, device: int) -> Values:
    """Values as one device has them."""
    return {
        name: float(value if np.ndim(value) == 0 else np.asarray(value)[device])
        for name, value in values.items()
    }


def running(grid: Sequence[Values]) -> str | None:
    """The first parameter that differs from value to value of a grid."""
    for name in grid[0]:
        if len({one.get(name) for one in grid}) > 1:
            return name
    return None


def ranked(kind: EffectKind, law: DeviceLaw, scorer: Scorer) -> Ranked:
    """Rank the values of a law's grid, and of what the residual itself proposes."""
    grid = _grid(kind, law, scorer)
    scorer.space.courses.ahead(law, grid)
    own = kind.own_grid(scorer.space.signals.record)
    devices = law.patterns[0].shape[1]
    error = scorer.own_error(kind)
    alone = np.full((len(grid) + len(own), devices), -np.inf)
    together = np.full((len(grid), 2), -np.inf)  # of all devices, and of the best group
    shown = np.zeros(len(grid) + len(own))
    groups = list(law.groups.values())
    seen_late = sign if scales(kind) else sign_of_share
    for number, values in enumerate((*grid, *own)):
        spectra = scorer.space.courses.spectra(law, values)
        if not any(np.any(one) for one in spectra):
            continue
        pull, information = scorer.apart(law, values, error)
        worths = [worth for worth, _ in worths_of(kind)]
        alone[number] = np.max([worth(pull, information) for worth in worths], axis=0)
        shown[number] = float(seen_late(pull, information).max())
        if number >= len(grid):
            continue
        seen = [
            scorer.together(block, spectrum, groups)
            for block, spectrum in zip(law.patterns, spectra, strict=True)
        ]
        total = np.array([np.sum(pull), *(np.sum(pull[one]) for one in groups)])
        whole = np.array([[one, *parts] for one, parts in seen]).sum(axis=0)
        gain = np.max([worth(total, whole) for worth in worths], axis=0)
        together[number] = gain[0], gain[1:].max(initial=-np.inf)
        shown[number] = max(shown[number], float(seen_late(total, whole).max()))
    top = alone[: len(grid)].max(axis=1)
    marks = (top, *together.T)
    best = {int(one) for mark in marks for one in np.argsort(-mark)[:RANKED_VALUES]}
    hopeful = np.max([top - HOPE, *together.T], axis=0) > 0.0
    if kind.sudden and not scales(kind):
        # Of the grid's ends: a law whose course is that of an error has it at one of them.
        for number in {0, len(grid) - 1}:
            if stood_in(kind, law, grid[number], scorer):
                shown[number] = np.inf
    late = np.argsort(-shown, kind="stable")[:RANKED_VALUES]
    return Ranked(
        grid, own, alone,
        [grid[number] for number in sorted(best) if hopeful[number]],
        [(*grid, *own)[number] for number in sorted(late) if shown[number] > ONSET_SIGN],
    )  # fmt: skip


def stood_in(kind: EffectKind, law: DeviceLaw, values: OwnValues, scorer: Scorer) -> bool:
    """Whether healthy errors of the devices make what a law does over the whole record.

    A corrector that stands still is one of gain −1 as long as it does so: nothing of it shows
    but where it begins.
    """
    own = scorer.own_error(kind)
    if own is None:
        return False
    left, whole = scorer.apart(law, values, own)[1], scorer.apart(law, values, None)[1]
    there = (whole > 0.0) & (own.variance > 0.0) & (own.information > 0.0)
    if not there.any():
        return False
    known = 1.0 / own.variance[there] + own.information[there]
    alike = (whole - left)[there] * known / (whole * own.information)[there]
    return float(np.median(alike)) > STOOD_IN


def sign(pull: Vector, information: Vector) -> Vector:
    """Log likelihood ratio of terms with their best sizes."""
    return pull**2 / (2.0 * np.maximum(information, 1e-300))


def sign_of_share(pull: Vector, information: Vector) -> Vector:
    """Log likelihood ratio of terms of a given size that may begin late.

    The whole record shows a share of their size, from nothing to all of it.
    """
    share = np.clip(pull / np.maximum(information, 1e-300), 0.0, 1.0)
    return share * pull - 0.5 * share**2 * information


def _grid(kind: EffectKind, law: DeviceLaw, scorer: Scorer) -> Sequence[Values]:
    """Values to scan: those of the grid, and those that the residual itself proposes."""
    grid = scorer.space.courses.grid(kind)
    signals = scorer.space.signals

    def drive_pull() -> Matrix:
        return scorer.rows.drive_pull(signals.record.layout.response)

    more = kind.proposed(signals.currents, drive_pull, signals.record)
    return (*grid, *more)


def worths_of(kind: EffectKind) -> list[tuple[Worth, bool]]:
    """How sets of the law are weighed: with the size that its values say, or with any.

    A law that has no value to find may have any size while it is scanned: healthy errors of other
    devices stand in for a part of it, which only its exact evidence takes into account.
    """
    choices: list[tuple[Worth, bool]] = []
    if scales(kind):
        choices.append((any_size, True))
    if not scales(kind) or (kind.linear and len(kind.parameters) > 1):
        nothing = all(parameter.optional for parameter in kind.parameters)
        choices.append((any_size if nothing else given_size, False))
    return choices


def cost_of(kind: EffectKind, values: Values, scorer: Scorer) -> float:
    """What choosing the values of an effect costs [nats]."""
    chosen = kind.set_by(values, scorer.space.signals.record)
    return VALUE_COST * len(chosen) + needles(kind, values, scorer)


def needles(kind: EffectKind, values: Values, scorer: Scorer) -> float:
    """What values cost besides, because others were as likely to be the best by chance [nats]."""
    return float(np.log(kind.told_apart(values, scorer.space.signals.record)))


def scales(kind: EffectKind) -> bool:
    """Whether a course may have any size: one that runs over a grid of its sizes has them there."""
    return bool(kind.linear) or len(kind.sizes) > 1


def within(kind: EffectKind, values: Values, size: float) -> float:
    """Keep a size where its parameters have a meaning: no share of a field is above one."""
    for parameter in kind.sizes:
        unit = values[parameter.name]
        if unit:
            ends = sorted((parameter.low / unit, parameter.high / unit))
            size = min(max(size, ends[0]), ends[1])
    return size


def any_size_at(pull: Vector, information: Vector, size: float) -> float:
    """Log evidence of a term of any size, less what is lost where its best one has no meaning."""
    best = float(best_size(pull, information, SIZE_WIDTH**2)[0])
    lost = 0.5 * float(information[0] + SIZE_WIDTH**-2) * (size - best) ** 2
    return float(any_size(pull, information)[0]) - lost


def any_size(pull: Vector, information: Vector) -> Vector:
    """Log evidence of terms of any size."""
    return normal_size(pull, information, SIZE_WIDTH**2)
