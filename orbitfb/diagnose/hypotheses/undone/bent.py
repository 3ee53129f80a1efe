"""A BPM whose readings a law changes much: the size that undoes them best.

Its own scale says how good a size is: T frequencies whose mean square falls from v to v' when the
readings are undone are worth −T/2 ln(v'/v) [nats].
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.ranking import within
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.row_sums import OwnError
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import hearing
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.estimation.maxima import climbed, highest
from orbitfb.estimation.priors import FINENESS, MORE, VALUE_COST
from orbitfb.estimation.transform import Matrix

_REACH = (0.25, 2.0)
"""Share of the size that follows in a straight line between which a bent one is sought [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Undoing:
    """What the readings of one BPM say once it is undone.

    Args:
        kind: An effect of BPMs that is undone in their readings.
        scorer: Of what is left to explain.
        precise: Precision of the BPM at every frequency, shape (T,) [1/m²].
        left: Ω z of what errors of other devices leave of it, shape (T,) [1/m].
        error: Its own healthy error; None: it has none.
    """

    kind: EffectKind
    scorer: Scorer
    precise: Single
    left: Matrix
    error: OwnError | None

    @classmethod
    def of(cls, kind: EffectKind, scorer: Scorer, source: Course) -> "Undoing":
        """Lay out a BPM."""
        chosen = np.array(source.places)
        return cls(
            kind, scorer,
            (scorer.weights @ (scorer.modes[chosen] ** 2).T)[:, 0],
            scorer.beside_others(kind.target)[:, chosen[0]], scorer.own_error(kind, chosen),
        )  # fmt: skip

    def worth(self, source: Course) -> float:
        """Log likelihood of its readings, undone."""
        space = self.scorer.space
        ((_, change, widened),) = source.undone(self.kind, space.signals)
        added = space.transform.quick_spectrum(change)[:, 0]
        inside = ~space.signals.record.starts
        return float(np.sum(widened[inside])) + self.density(self.left - self.precise * added)

    def density(self, pulled: Vector) -> float:
        """Log density of what is left, by its own scale; its error may be anything usual."""
        square = float(np.mean(pulled**2 / self.precise))
        if self.error is not None and self.error.variance[0] > 0.0:
            own = self.error.spectrum[:, 0]
            known = square / self.error.variance[0] + float(self.precise @ own**2)
            square -= float(own @ pulled) ** 2 / (known * len(pulled))
        return -0.5 * len(pulled) * float(np.log(square))

    def bends(self, source: Course, worth: float) -> bool:
        """Whether undoing the BPM is worth another thing than what it makes of the predicted orbit.

        Args:
            source: The BPM with its sizes.
            worth: Log likelihood of what it makes of the orbit, over none.
        """
        return abs(self.worth(source) - self.density(self.left) - worth) >= MORE

    def best(self, source: Course) -> tuple[Course, float, Single]:
        """The BPM with the size that undoes its readings best: it, log likelihood and field.

        A course is told of the orbit as it is read, in which the law is already: a curve that takes
        a quarter off a reading looks as if it took a third. Of several sizes it is the one that
        does alone, unless all of them do better by what a value costs. What the BPM adds is told of
        the orbit that is predicted from readings without it.

        Args:
            source: The BPM, with sizes near which the best are sought.
        """
        kind, scorer, space, chosen = self.kind, self.scorer, self.scorer.space, list(source.places)
        if len(kind.sizes) > 1:
            best = _of_sizes(source, space.courses.largest(kind), self.worth)
        else:
            share = highest(lambda share: self.worth(scaled(kind, source, share)), _REACH, FINENESS)
            best = scaled(kind, source, within(kind, source.values, share))
        added = np.zeros_like(space.signals.orbit)
        ((_, added[:, chosen], _),) = best.undone(kind, space.signals)
        (course,) = best.of(hearing(space, added).signals, best.values)
        field = np.zeros(scorer.pulled.shape, dtype=np.float32)
        field[:, chosen] = space.transform.quick_spectrum(course)
        # At least: beside errors that stand in for it, and by what the predicted orbit shows of it.
        least = self.worth(best) - self.density(scorer.pulled[:, chosen[0]])
        return best, max(least, scorer.likelihood(field)), field


def scaled(kind: EffectKind, source: Course, size: float) -> Course:
    """A device with its sizes times a factor."""
    values = {one.name: size * source.values[one.name] for one in kind.sizes}
    return replace(source, values={**source.values, **values})


def _of_sizes(its: Course, unit: Values, worth: Callable[[Course], float]) -> Course:
    """A device with the size that explains most alone, or with all if they explain more.

    Args:
        its: The device, with its sizes so far.
        unit: How large each size may be.
        worth: What sizes explain [nats].
    """
    now = {name: its.values[name] for name in unit}

    def best(free: Sequence[str]) -> tuple[float, Course]:
        def at(shares: Vector) -> Course:
            told = dict(zip(free, shares.tolist(), strict=True))
            sizes = {name: told.get(name, 0.0) * unit[name] for name in now}
            return replace(its, values={**its.values, **sizes})

        begin = np.array([now[name] / unit[name] for name in free])
        step = 0.5 * max(abs(value) / unit[name] for name, value in now.items())
        found = at(climbed(lambda shares: worth(at(shares)), begin, step))
        return worth(found), found

    alone = max((best([name]) for name in now), key=lambda one: one[0])
    every = best(list(now))
    return (every if every[0] > alone[0] + VALUE_COST else alone)[1]
