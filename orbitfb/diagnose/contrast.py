"""How far models are from the best there is, on a record that none of them was fitted to.

What is wrong with a prediction cannot be read off its squared error: the noise of the readings is
far larger, and the floor is known no better than to a per cent. But what two models predict
differently, δ, is known exactly and is independent of the noise to come. So the error of the
nominal model is estimated within the span of the differences, d = Σ b δ with the b of a
regression of the innovations on them, and every model's distance from d follows, with the noise
of b taken off. A right cause has b = 1; a wrong one has 0, and its own δ as its error.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.blocks import BLOCK, Draws
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.open_errors import OpenErrors
from orbitfb.diagnose.replay import NOMINAL, Model, Replay
from orbitfb.physics.optics import Matrix


class Contrast:
    """The nominal model, that with the causes and a competitor on a later record.

    Args:
        replay: The later record.
        causes: As they act in it.
        change: The competitor's change of R, shape (n, m) [m/A].
        seed: Of the bootstrap.
        rivals: Other causes, fitted each alone, that the error of the nominal model may consist
            of: without them a stand-in is not told from the right cause.
        net: Orbit that a second competitor adds, shape (N, n) [m]; None: there is none. It widens
            the span for its own figures only: those of the others are the same with and without.
        healthy: What healthy errors may do in the later record; None: what they do in it is known.

    Attributes:
        model: With all the causes.
        competitor: With the change of R instead.
        nominal: Weights of the differences in the nominal model, shape (k,).
        mine: Those in `model`.
        other: Those in `competitor`.
        second: Those in the second competitor, shape (k + 1,); None: there is none.
        ticks: That are predicted.
    """

    def __init__(
        self,
        replay: Replay,
        causes: Sequence[Cause],
        change: Matrix,
        seed: int,
        rivals: Sequence[Cause] = (),
        net: Matrix | None = None,
        healthy: OpenErrors | None = None,
    ) -> None:
        self.replay, self._seed, self._healthy = replay, seed, healthy
        ladder = [Model(tuple(causes[:count])) for count in range(len(causes) + 1)]
        self._pairs = [*itertools.pairwise(ladder)]
        self.model = ladder[-1]
        self.competitor = Model(change=change)
        self._pairs.append((NOMINAL, self.competitor))
        self._pairs += [(NOMINAL, Model((rival,))) for rival in rivals]
        self.nominal = np.zeros(len(self._pairs))
        self.mine, self.other = self.nominal.copy(), self.nominal.copy()
        self.mine[: len(causes)] = 1.0
        self.other[len(causes)] = 1.0
        self.second: Vector | None = None
        if net is not None:
            self.second = np.append(np.zeros(len(self._pairs)), 1.0)
            self._pairs.append((NOMINAL, Model(orbit=net)))
        self.draws = Draws.of(replay.counted(), seed)
        self.ticks = int(replay.counted().sum())
        differences = [self._white(change) for change in self._differences(1)]
        left = [self._left(change) for change in differences]
        error = self._left(self._white(replay.errors(NOMINAL)))
        normal = self.draws.sums(_products(differences, left))
        self._normal = 0.5 * (normal + normal.swapaxes(1, 2))  # alike over all rows only
        self._score = self.draws.sums(_products(differences, [error]))[:, :, 0]
        self._solved: dict[int, tuple[Matrix, Vector]] = {}

    def likelihood(self, model: Model) -> Vector:
        """Gain of log-likelihood over the nominal model [nats/tick], shape (DRAWS + 1,)."""
        nominal, its = (
            np.sum(white * self._left(white), axis=1)
            for white in (self.replay.white(NOMINAL), self.replay.white(model))
        )
        jacobian = self.replay.jacobian(model).sum(axis=1)
        return self.draws.means(0.5 * (nominal - its) + jacobian)

    def distance(self, weights: Vector) -> Vector:
        """Gap of a model to the best in the span [nats/tick], shape (DRAWS + 1,).

        Args:
            weights: Of the differences in the model: `nominal`, `mine`, `other` or `second`.
        """
        return 0.5 * self._square(weights, self._normal) / self.ticks

    def excess(self, weights: Vector, steps: int = 1) -> Vector:
        """Excess rms so many steps ahead [µm], shape (DRAWS + 1,).

        Args:
            weights: As for `distance`.
            steps: Ticks ahead.
        """
        return self.excesses([weights], steps)[0]

    def excesses(self, models: Sequence[Vector], steps: int = 1) -> list[Vector]:
        """As `excess`, of several models at once."""
        counted = self.replay.counted(steps)
        differences = self._differences(steps)
        rows = max(int(counted.sum()), 1)
        draws = Draws.of(counted, self._seed) if steps <= BLOCK else None
        products = _products(differences, differences)
        if draws is None:
            size = np.broadcast_to(products[counted].sum(axis=0), self._normal.shape)
        else:
            size = draws.sums(products)
        scale = rows * self.replay.record.readings.shape[1]
        return [
            1e6 * np.sqrt(np.maximum(self._square(weights, size), 0.0) / scale)
            for weights in models
        ]

    def _square(self, weights: Vector, size: Matrix) -> Vector:
        """Squared length of d − (the model's differences), the noise of b taken off.

        The draws have the noise twice: that of the record and that of drawing from it.
        """
        own = len(weights)
        inverse, share = self._span(own)
        size = size[:, :own, :own]
        off = share - weights
        length = np.einsum("di,dij,dj->d", off, size, off)
        noise = np.einsum("dij,dji->d", size, inverse)
        noise[1:] *= 2.0
        return np.maximum(length - noise, 0.0)

    def _span(self, count: int) -> tuple[Matrix, Vector]:
        """Inverse of the normal equations of the first differences, and their weights b."""
        if count not in self._solved:
            normal = self._normal[:, :count, :count]
            inverse = np.asarray(
                np.linalg.pinv(normal, hermitian=True, rcond=1e-9), dtype=np.float64
            )
            share = np.einsum("dij,di->dj", inverse, self._score[:, :count])
            self._solved[count] = inverse, np.asarray(share, dtype=np.float64)
        return self._solved[count]

    def _differences(self, steps: int) -> list[Matrix]:
        return [
            self.replay.errors(one, steps) - self.replay.errors(other, steps)
            for one, other in self._pairs
        ]

    def _left(self, white: Matrix) -> Matrix:
        """What healthy errors leave of innovations, shape (N, n)."""
        return white if self._healthy is None else self._healthy.left(white)

    def _white(self, errors: Matrix) -> Matrix:
        return self.replay.floor.to_modes(errors) / self.replay.deviation


def _products(left: Sequence[Matrix], right: Sequence[Matrix]) -> Matrix:
    """Scalar products of every row, shape (N, len(left), len(right))."""
    return np.stack(
        [np.stack([np.sum(a * b, axis=1) for b in right], axis=1) for a in left], axis=1
    )
