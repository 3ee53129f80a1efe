"""Small random excursions as questions to the ring: what answers them is there.

The loop sets the correctors aside by d = s B ξ, its signs ξ = ±1 drawn anew at every tick. Nothing
else that moves the orbit, and no reading that does not see the beam, can know the signs. So if a
share c of x = R d shows in the next orbit y, and f is any guess of y made before they were drawn,
e = y − f − c x knows nothing of ξ, and over the questions

    M = Σ x e,   V = Σ (x e)²

of a BPM are a sum of random signs and its variance: z = M / √V exceeds h with the chance
exp(−h² / 2) at most (Hoeffding 1963), whatever the noise, the drift, the kicks and the loop do.
For the ring as a whole the variance over the signs is known at once, V = Σ s² |(R B)ᵀ e|², so that
few questions suffice. For correctors, d ∘ Rᵀ e / s² is multiplied by the inverse of
(B Bᵀ) ∘ (Rᵀ R): what of it comes of the neighbours' answers is told apart.

A device answers if "c is `LITTLE` or less" is refuted, it does not if "c is `MUCH` or more" is.

Sources: Hoeffding, J. Amer. Statist. Assoc. 58 (1963) 13; that only a watermark tells replayed
readings from a ring that answers: Mo and Sinopoli, Allerton Conf. (2009) 911.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.answers.questions import CLIP, Question, Ring, Sight

LITTLE = 0.2
"""Share of an answer up to which a device does not answer [1]: neighbours may feign as much."""

MUCH = 0.6
"""Share of an answer from which a device does [1]: half of an answer harms nobody, the loop then
corrects at half its speed; and no response matrix in use is wrong by so much."""


@dataclass(frozen=True, slots=True, eq=False)
class Test:
    """Sums that speak for and against an answer, each at some lags.

    Args:
        little: M for c = `LITTLE`, shape (lags, devices).
        little_power: V of it.
        much: M for c = `MUCH`.
        much_power: V of it.
        asked: Σ x², what M is in the mean for c = 0 and an answer of 1, shape (lags, devices).
    """

    little: Vector
    little_power: Vector
    much: Vector
    much_power: Vector
    asked: Vector

    @classmethod
    def none(cls, lags: int, devices: int) -> "Test":
        """Begin without a word."""
        zero = np.zeros((lags, devices))
        return cls(zero, zero, zero, zero, zero)

    def add(
        self,
        lag: int,
        little: Vector,
        little_power: Vector,
        much: Vector,
        much_power: Vector,
        asked: Vector | float = 0.0,
    ) -> "Test":
        """Add what one orbit says at one lag, each of shape (devices,)."""

        def plus(total: Vector, value: Vector | float) -> Vector:
            total = total.copy()
            total[lag] += value
            return total

        return Test(
            plus(self.little, little),
            plus(self.little_power, little_power),
            plus(self.much, much),
            plus(self.much_power, much_power),
            plus(self.asked, asked),
        )

    def _each(self, change: Callable[[Vector], Vector]) -> "Test":
        return Test(*(change(getattr(self, item.name)) for item in fields(self)))

    def anew(self, which: Mask) -> "Test":
        """Forget what was said of some, shape (devices,)."""
        if not which.any():
            return self
        return self._each(lambda sums: sums * ~which)

    def forget(self, row: int) -> "Test":
        """Begin one row anew."""
        keep = np.ones((len(self.little), 1))
        keep[row] = 0.0
        return self._each(lambda sums: keep * sums)

    def first(self, rows: int) -> "Test":
        """Take the first rows alone."""
        return self._each(lambda sums: sums[:rows])

    def last(self, rows: int) -> "Test":
        """Take the last rows alone."""
        return self._each(lambda sums: sums[-rows:])

    @property
    def sure(self) -> Vector:
        """Evidence z for an answer at the best lag, shape (devices,) [1]."""
        return _over(self.little, self.little_power).max(axis=0)

    @property
    def doubt(self) -> Vector:
        """Evidence z against an answer in time, shape (devices,) [1]."""
        return _over(-self.much[0], self.much_power[0])

    @property
    def told(self) -> Vector:
        """Evidence z that there would be against one that does not answer, (devices,) [1]."""
        return _over(MUCH * self.asked[0], self.much_power[0])

    @property
    def silence(self) -> Vector:
        """Evidence z against an answer at any lag, shape (devices,) [1]."""
        return _over(-self.much, self.much_power).min(axis=0)

    @property
    def lag(self) -> int:
        """Lag at which the first device answers most."""
        return int(np.argmax(_over(self.little, self.little_power)[:, 0]))


def _over(value: Vector, power: Vector) -> Vector:
    return value / np.sqrt(np.maximum(power, np.finfo(np.float64).tiny))


def ask_ring(
    test: Test, sight: Sight, questions: tuple[Question | None, ...], ring: Ring, usual: int
) -> Test:
    """Look for the answer of the ring as a whole.

    Args:
        test: So far, a row for every lag, one for what the surprise says at once, and one for all
            lags together.
        sight: The orbit.
        questions: Sent before it, newest first; None: none was.
        ring: The response.
        usual: Lag at which the ring answers, for all that is known.
    """
    weight, most = np.where(sight.valid, sight.spread**-2.0, 0.0), CLIP * sight.spread
    for lag, question in enumerate(questions[: len(test.little) - 2]):
        if question is None:
            continue
        besides, asked = sight.position - question.still, question.asked
        left = np.stack([besides - share * asked for share in (LITTLE, MUCH)])
        left = weight * np.clip(left, -most, most)
        value = left @ asked
        power = question.size**2 * np.sum((left @ ring.moves) ** 2, axis=1)
        test = test.add(lag, value[:1], power[:1], value[1:], power[1:])
        if lag == usual:
            known = np.clip(sight.surprise + (1.0 - LITTLE) * asked, -most, most)
            value = np.array([(weight * asked) @ known])
            power = np.array([np.sum((weight * asked) ** 2 * sight.noise)])
            test = test.add(-2, value, power, np.zeros(1), np.zeros(1))
    return test


def ask_at_any(test: Test, sight: Sight, question: Question, heard: Vector, ring: Ring) -> Test:
    """Look for the answer of the ring among all the orbits at which it may come.

    A computer that is busy sends one change in time and the next one late: an answer at now this
    lag, now that one, is none at each of them.

    Args:
        test: So far, with the same rows.
        sight: The last orbit.
        question: Whose time is over.
        heard: Sum of y − f of those orbits, shape (n,) [m].
        ring: The response.
    """
    weight, most = np.where(sight.valid, sight.spread**-2.0, 0.0), CLIP * sight.spread
    left = weight * np.clip(heard - MUCH * question.asked, -most, most)
    power = np.array([question.size**2 * np.sum((left @ ring.moves) ** 2)])
    return test.add(-1, np.zeros(1), np.zeros(1), np.array([left @ question.asked]), power)


def ask_devices(
    test: Test, sight: Sight, now: Question | None, before: Question | None, ring: Ring
) -> Test:
    """Look for the answer of each BPM, in time or one orbit late, and of each corrector.

    Args:
        test: So far, two rows of n + m.
        sight: The orbit.
        now: The question that the ring answers with it; None: there was none.
        before: The one before that.
        ring: The response.
    """
    most = CLIP * sight.spread
    m = len(sight.recent)
    noise = np.median(sight.noise)
    for late, question in enumerate((now, before)):
        if question is None:
            continue
        asked = np.where(sight.valid, question.asked, 0.0)
        besides = sight.position - question.still
        known = besides if late else sight.surprise + asked
        little = asked * np.clip(known - LITTLE * asked, -most, most)
        left = np.clip(besides - MUCH * asked, -most, most)
        usual, reach = asked**2 * sight.noise, question.size**2 * ring.reach * left**2
        nothing: Vector = np.zeros(m)
        share, doubt, power, answer = nothing, nothing, nothing, nothing
        if not late:
            clipped = np.where(sight.valid, np.clip(sight.surprise, -most, most), 0.0)
            alone = ring.apart @ (question.excursion * (clipped @ ring.response))
            own = sight.recent * (ring.mixed @ question.excursion)
            others: Vector = sight.recent - question.excursion  # known before the signs were drawn
            unsure: Vector = np.diag(ring.apart) * noise
            # What else was just changed only blurs the answer: such orbits count less.
            weight: Vector = unsure / (unsure + others**2 * ring.swing)
            weight = weight / question.size**2
            share = weight * (alone + (1.0 - LITTLE) * own)
            doubt = weight * (alone + (1.0 - MUCH) * own)
            power = weight**2 * unsure * question.size**2
            answer = weight * own
        test = test.add(
            late,
            np.concatenate((little, share)),
            np.concatenate((usual, power)),
            np.concatenate((asked * left, doubt)),
            np.concatenate((np.where(sight.valid, reach, 0.0), doubt**2)),
            np.concatenate((asked**2, answer)),
        )
    return test
