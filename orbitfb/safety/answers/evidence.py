"""Small random excursions as questions to the ring: what answers them is there.

The loop sets the correctors aside by d = s B ξ, its signs ξ = ±1 drawn anew at every tick. Nothing
else that moves the orbit, and no reading that does not see the beam, can know the signs. So if a
share c of x = R d shows in the next orbit y, and f is any guess of y made before they were drawn,
e = y − f − c x knows nothing of ξ, and over the questions

    M = Σ x e,   V = Σ (x e)²

of a BPM are a sum of random signs and its variance: z = M / √V exceeds h with the chance
exp(−h² / 2) at most (Hoeffding 1963), whatever the noise, the drift, the kicks and the loop do.
For the ring as a whole the variance over the signs is known at once, V = Σ s² |(R B)ᵀ e|², so that
few questions suffice. For corrector j, e is what the orbit misses if j took the share c of its
change r = u + d, where u was known before the signs, and d ∘ Rᵀ e / s² is multiplied by row j of
the inverse of (B Bᵀ) ∘ (Rᵀ R): what of it comes of the neighbours' answers is told apart. If j
took nothing, c u is left in e, and its product with the signs is part of V.

No single reading counts more than `CLIP` times its usual deviation from the hypothesis that is
tested, of correctors that of noise and question together: clipped around any other one it would
look like part of an answer.

A device answers if "c is `LITTLE` or less" is refuted, it does not if "c is `MUCH` or more" is.

Sources: Hoeffding, J. Amer. Statist. Assoc. 58 (1963) 13; that only a watermark tells replayed
readings from a ring that answers: Mo and Sinopoli, Allerton Conf. (2009) 911.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.robust import median
from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.answers.questions import CLIP, Question, Ring, Sight

LITTLE = 0.2
"""Share of an answer up to which a device does not answer [1]: neighbours may feign as much."""

MUCH = 0.6
"""Share of an answer from which a device does [1]: half of an answer harms nobody, the loop then
corrects at half its speed; and no response matrix in use is wrong by so much."""

SHARES = np.array([[LITTLE], [MUCH]])
"""Both, shape (2, 1)."""


LITTLE_M, LITTLE_V, MUCH_M, MUCH_V, ASKED = range(5)
"""Where the sums of a `Test` stand."""


@dataclass(frozen=True, slots=True, eq=False)
class Test:
    """Sums that speak for and against an answer, each at some lags.

    Args:
        sums: Of M and V for c = `LITTLE`, M and V for c = `MUCH`, and what −M is in the mean for
            c = `MUCH` and no answer, shape (5, lags, devices).
    """

    sums: Vector

    @classmethod
    def none(cls, lags: int, devices: int) -> "Test":
        """Begin without a word."""
        return cls(np.zeros((5, lags, devices)))

    def add(self, more: Vector) -> "Test":
        """Add what one orbit says, shape (5, lags, devices)."""
        return Test(self.sums + more)

    def anew(self, which: Mask) -> "Test":
        """Forget what was said of some, shape (devices,)."""
        return Test(self.sums * ~which) if which.any() else self

    def forget(self, row: int) -> "Test":
        """Begin one row anew."""
        sums = self.sums.copy()
        sums[:, row] = 0.0
        return Test(sums)

    def first(self, rows: int) -> "Test":
        """Take the first rows alone."""
        return Test(self.sums[:, :rows])

    def last(self, rows: int) -> "Test":
        """Take the last rows alone."""
        return Test(self.sums[:, -rows:])

    @property
    def sure(self) -> Vector:
        """Evidence z for an answer at the best lag, shape (devices,) [1]."""
        return _over(self.sums[LITTLE_M], self.sums[LITTLE_V]).max(axis=0)

    @property
    def doubt(self) -> Vector:
        """Evidence z against an answer in time, shape (devices,) [1]."""
        return _over(-self.sums[MUCH_M, 0], self.sums[MUCH_V, 0])

    @property
    def told(self) -> Vector:
        """Evidence z that there would be against one that does not answer, (devices,) [1]."""
        return _over(self.sums[ASKED, 0], self.sums[MUCH_V, 0])

    @property
    def silence(self) -> Vector:
        """Evidence z against an answer at any lag, shape (devices,) [1]."""
        return _over(-self.sums[MUCH_M], self.sums[MUCH_V]).min(axis=0)

    @property
    def lag(self) -> int:
        """Lag at which the first device answers most."""
        return int(np.argmax(_over(self.sums[LITTLE_M, :, 0], self.sums[LITTLE_V, :, 0])))


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
    most, more = CLIP * sight.spread, np.zeros_like(test.sums)
    weight = np.where(sight.valid, sight.spread**-2.0, 0.0)
    lags = len(more[0]) - 2
    there = [(lag, one) for lag, one in enumerate(questions[:lags]) if one is not None]
    if not there:
        return test
    rows, asked = [lag for lag, _ in there], np.stack([one.asked for _, one in there])
    besides = sight.position - np.stack([one.still for _, one in there])
    sizes = np.array([one.size for _, one in there])
    # Both shares of each question at once, shape (questions, 2, n).
    left = weight * np.clip(besides[:, None] - SHARES * asked[:, None], -most, most)
    value = np.sum(left * asked[:, None], axis=2)
    power = sizes[:, None] ** 2 * np.sum((left @ ring.moves) ** 2, axis=2)
    more[LITTLE_M, rows, 0], more[MUCH_M, rows, 0] = value.T
    more[LITTLE_V, rows, 0], more[MUCH_V, rows, 0] = power.T
    if usual in rows:
        x = asked[rows.index(usual)]
        known = np.clip(sight.surprise + (1.0 - LITTLE) * x, -most, most)
        more[LITTLE_M, -2, 0] = (weight * x) @ known
        more[LITTLE_V, -2, 0] = (weight * x) ** 2 @ sight.noise
    return test.add(more)


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
    more = np.zeros_like(test.sums)
    more[MUCH_M, -1, 0] = left @ question.asked
    more[MUCH_V, -1, 0] = question.size**2 * np.sum((left @ ring.moves) ** 2)
    return test.add(more)


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
    most, more = CLIP * sight.spread, np.zeros_like(test.sums)
    n = len(sight.position)
    for late, question in enumerate((now, before)):
        if question is None:
            continue
        row, asked = more[:, late], np.where(sight.valid, question.asked, 0.0)
        besides = sight.position - question.still
        known = besides if late else sight.surprise + asked
        left = np.clip(besides - MUCH * asked, -most, most)
        reach = question.size**2 * ring.reach * left**2
        row[LITTLE_M, :n] = asked * np.clip(known - LITTLE * asked, -most, most)
        row[ASKED, :n] = asked * np.clip(MUCH * asked, -most, most)
        row[LITTLE_V, :n] = asked**2 * sight.noise
        row[MUCH_M, :n], row[MUCH_V, :n] = asked * left, np.where(sight.valid, reach, 0.0)
        if late:
            continue
        row[:, n:] = _of_correctors(sight, question, ring)
    return test.add(more)


def _of_correctors(sight: Sight, question: Question, ring: Ring) -> Vector:
    """Give what an orbit says of each corrector, shape (5, m)."""
    # What tells each one's answer in the orbit from its neighbours', shape (n, m).
    telling = ring.response @ (question.excursion[:, None] * ring.apart)
    telling = np.where(sight.valid[:, None], telling, 0.0)
    own = ring.response * sight.recent
    # As loud as the question no answer is clipped: the signs of all then tell each one's apart.
    most = CLIP * np.hypot(sight.spread, question.size)
    noise = median(np.clip(np.abs(sight.surprise), sight.spread, most) ** 2)

    def heard(orbit: Vector) -> Vector:
        """Give M of all of them for what each would leave, shape (n, m) [m]."""
        return np.sum(telling * np.clip(orbit, -most[:, None], most[:, None]), axis=0)

    others = sight.recent - question.excursion  # known before the signs were drawn
    blurred = others**2 * ring.swing
    usual, unsure = (np.diag(ring.apart) * one for one in (median(sight.spread) ** 2, noise))
    # What else was just changed, or moved the beam, only blurs the answer: such orbits count less.
    weight = usual / (unsure + blurred) / question.size**2
    surprise = sight.surprise[:, None]
    much = weight * heard(surprise + (1.0 - MUCH) * own)
    sums = np.empty((5, len(weight)))
    sums[LITTLE_M] = weight * heard(surprise + (1.0 - LITTLE) * own)
    sums[LITTLE_V] = (weight * question.size) ** 2 * (unsure + LITTLE**2 * blurred)
    sums[MUCH_M], sums[MUCH_V] = much, much**2
    sums[ASKED] = weight * heard(MUCH * own)
    return sums
