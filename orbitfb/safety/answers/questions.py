"""Small random excursions as questions to the ring, and the orbit in which an answer may show.

What an answer proves stands in `evidence`.
"""

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from orbitfb.core.robust import median
from orbitfb.core.signals import Mask, Vector

FLAT = 0.03
"""Singular value, over the largest, below which a mode of R is asked less [1]. The first five modes
of the default ring are above: questions spread over all the others alike, and their currents stay
below 1 mA for 0.3 µm of orbit."""

SINGULAR = 1e-6
"""Relative size below which differences between correctors are rounding [1]."""

MEDIAN = 0.455
"""Median of the square of a normal number [1]."""

KEPT = 4
"""Rings that are remembered: that of the policy in force and of the one before, each with and
without what is left out."""

CLIP = 4.0
"""Largest deviation from the guess that counts, over its usual size: one kick is one question."""


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A response matrix and what is made of it once.

    Args:
        response: R, shape (n, m) [m/A].
        movable: Correctors that are asked, shape (m,).
        sizes: Rms of each column, shape (m,) [m/A].
        patterns: B, excursions that move the orbit by 1 m rms all together, and alike in all the
            modes of R that can be moved, shape (m, q) [A].
        moves: R B, shape (n, q) [m].
        reach: Squared length of each of its rows, shape (n,) [m²].
        apart: Inverse of (B Bᵀ) ∘ (Rᵀ R), which tells correctors apart whose excursions and
            answers are alike, shape (m, m) [1/m²].
        swing: Squared length of each row of (Rᵀ R ∘ `apart`) B, shape (m,) [1/A²].
    """

    response: Vector
    movable: Mask
    sizes: Vector
    patterns: Vector
    moves: Vector
    reach: Vector
    apart: Vector
    swing: Vector

    @classmethod
    def of(cls, response: Vector, movable: Mask) -> "Ring":
        """Look at a ring.

        Args:
            response: R, shape (n, m) [m/A].
            movable: Correctors that may be asked, shape (m,).
        """
        _, sizes, modes = np.linalg.svd(response * movable, full_matrices=False)
        least = FLAT * max(float(sizes[0]), float(np.finfo(np.float32).tiny))
        flat = movable[:, None] * modes.T / np.sqrt(sizes**2 + least**2)
        moves = response @ flat
        size = float(np.linalg.norm(moves))
        scale = np.sqrt(len(response)) / size if size else 0.0  # no corrector moves: none is asked
        patterns = scale * flat
        square = response.T @ response
        apart = _inverse((patterns @ patterns.T) * square)
        sizes = np.sqrt(np.mean(response**2, axis=0))
        moves, reach = scale * moves, scale**2 * np.sum(moves**2, axis=1)
        swing = np.sum(((apart * square) @ patterns) ** 2, axis=1)
        return cls(response, movable, sizes, patterns, moves, reach, apart, swing)


class Rings:
    """Keeps what was made of the matrices seen last, which takes longer than a tick.

    Any thread may ask. Two that meet a new matrix at once may both look at it; what they see is
    the same.
    """

    def __init__(self) -> None:
        self._known: deque[Ring] = deque(maxlen=KEPT)
        self._lock = threading.Lock()

    def of(self, response: Vector, movable: Mask) -> Ring:
        """Look at a ring, or remember it.

        Args:
            response: R, shape (n, m) [m/A]; it does not change.
            movable: Correctors that may be asked, shape (m,).
        """
        with self._lock:
            known = tuple(self._known)
        for ring in known:
            if ring.response is response and np.array_equal(ring.movable, movable):
                return ring
        ring = Ring.of(response, movable)
        with self._lock:
            self._known.append(ring)
        return ring


def _inverse(matrix: Vector) -> Vector:
    """Invert a symmetric matrix as far as it is not rounding."""
    sizes, modes = np.linalg.eigh(matrix)
    telling = sizes > SINGULAR * float(sizes[-1])
    return (modes[:, telling] / sizes[telling]) @ modes[:, telling].T


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """An excursion that was sent.

    Args:
        size: Orbit that it causes, rms over the BPMs [m].
        excursion: d, shape (m,) [A].
        asked: x = R d, shape (n,) [m].
        still: f, what was read of late, shape (n,) [m].
    """

    size: float
    excursion: Vector
    asked: Vector
    still: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """An orbit that may show answers.

    Args:
        position: y, shape (n,) [m]; finite also where a BPM does not count.
        valid: BPMs that count, shape (n,).
        surprise: y less what all that was sent should have made of the orbits before, shape (n,)
            [m].
        spread: Usual size of the surprise, shape (n,) [m].
        recent: What of the last changes is in the surprise if a corrector took none of them,
            shape (m,) [A].
    """

    position: Vector
    valid: Mask
    surprise: Vector
    spread: Vector
    recent: Vector

    @property
    def noise(self) -> Vector:
        """Mean square of the surprise, or that of this orbit if it is larger, shape (n,) [m²]."""
        return np.clip(np.abs(self.surprise), self.spread, CLIP * self.spread) ** 2

    def kicked(self, questions: tuple[Question | None, ...]) -> bool:
        """Say whether something else moved the whole orbit, by far more than usual.

        Such an orbit says nothing, and would drown what others said: neither that the ring
        answered, nor that it did not, nor that it answered late, explains it, and it is large
        beside the question, too. A ring of the other sign, or whose BPMs are exchanged, moves the
        beam by as much as was asked, but elsewhere: that is an answer, if a wrong one.

        Args:
            questions: That may show, newest first.
        """
        asked = [question for question in questions if question is not None]
        if not asked:
            return False
        still = self.position - asked[0].still
        left = [self.surprise, self.surprise + asked[0].asked, still]
        left += [still - question.asked for question in asked]
        usual = np.hypot(self.spread, max(question.size for question in asked))
        return min(median((part / usual)[self.valid] ** 2) for part in left) > (MEDIAN * CLIP**2)
