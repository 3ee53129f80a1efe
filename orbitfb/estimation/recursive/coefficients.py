"""The coefficients θ of all modes with their covariances, brought up to date in blocks of ticks.

A reading takes c cᵀ/S from the covariance P of a group and adds c ν/S to θ̂ of its modes. Added at
every tick, they would cost more than all else: P of every group would be written. So the terms of
the last ticks stand beside P and θ̂ as they are, and a tick reads these large arrays once:

    P u = P₀ u − Σ (c/S) (cᵀ u),     θ̂ᵀ u = θ̂₀ᵀ u + Σ (ν/S) (cᵀ u).

The terms are added to P₀ and θ̂₀ by products of matrices: some rows at every tick, so that no tick
is long. Every row has its turn once in a block of ticks.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.recursive.group import Group

_BLOCK = 16
"""Ticks whose terms stand beside the covariances [ticks]. Fewer make the products of matrices
slower; more hardly make a step faster, and reading R̂ slower."""


class Coefficients:
    """θ̂ of n modes, and P = cov(θ) and c = cov(θ, x) of every group of them.

    Args:
        groups: What is known beforehand.
        drift: What a tick adds to P of every group, shape (k, k).
    """

    def __init__(self, groups: Sequence[Group], drift: Vector) -> None:
        count, size, n = len(groups), len(drift), groups[-1].members.stop
        self._drift, self._diagonal = drift, np.array([group.drift for group in groups])
        # all that a regressor is multiplied with stands in one array: one product does it
        edges = [count * size, count * size + n]
        self._factors = np.zeros((edges[-1] + count * _BLOCK, size))
        self._products = np.zeros(len(self._factors))
        covariances, self._rows, past = np.split(self._factors, edges)
        moved, self._moved, self._along = np.split(self._products, edges)
        self._covariances = covariances.reshape(count, size, size)
        self._cross_moved = moved.reshape(count, size)
        # c of the ticks of a block, the present one in the present slot; −c/S and ν/S of each
        self._past = past.reshape(_BLOCK, count, size)
        self._taken = np.zeros((_BLOCK, count, size))
        self._worth = np.zeros((_BLOCK, count, n))
        self._slot, self._waiting = 0, False
        # the same, as products of matrices want them
        self._slots = self._along.reshape(_BLOCK, count)
        self._slots_of = self._slots.T[:, None]
        self._taken_of = self._taken.transpose(1, 0, 2)
        self._worth_rows = self._worth.reshape(len(past), n)
        group_of = np.repeat(np.arange(count), [group.size for group in groups])
        self._places = group_of * n + np.arange(n)
        pieces: list[tuple[Vector, Vector, Vector]] = []
        for number, group in enumerate(groups):
            covariance, rows = self._covariances[number], self._rows[group.members]
            covariance[:], rows[:] = group.covariance, group.rows
            its, taken = self._past[:, number], self._taken[:, number]
            for half in (slice(size // 2), slice(size // 2, size)):
                pieces.append((covariance[half], taken[:, half], its))
            pieces.append((rows, self._worth[:, number, group.members], its))
        self._turns = [pieces[slot::_BLOCK] for slot in range(_BLOCK)]

    def predict(self, regressor: Vector) -> tuple[Vector, Vector]:
        """Go on by a tick.

        Args:
            regressor: u, shape (k,).

        Returns:
            What the change does to the orbits, shape (n,) [m], until the next call; and what it
            adds to var(x) of every group, uᵀ(2c + P u), shape (groups,) [m²].
        """
        np.dot(self._factors, regressor, out=self._products)
        self._moved += self._along.dot(self._worth_rows)
        self._cross_moved += np.matmul(self._slots_of, self._taken_of)[:, 0]
        cross = self._past[self._slot]
        cross += self._cross_moved
        return self._moved, self._slots[self._slot] + cross.dot(regressor)

    def learn(self, worth: Vector, shares: Vector, noise: float) -> None:
        """Learn from the innovations of the readings.

        Modes of a group may differ in their noise: each moves by what its own innovation is
        worth, while P shrinks by what that of the whole group is worth.

        Args:
            worth: ν over its variance, mode by mode, shape (n,) [1/m].
            shares: r²/S of every group, shape (groups,) [1].
            noise: r², variance of the reading noise [m²].
        """
        cross = self._past[self._slot] * shares[:, None]
        np.multiply(cross, -1.0 / noise, out=self._taken[self._slot])
        self._worth[self._slot].reshape(-1)[self._places] = worth
        self._slot, self._waiting = (self._slot + 1) % _BLOCK, True
        self._add_terms(self._slot)
        self._past[self._slot] = cross

    def forget_orbit(self) -> None:
        """Let what is not known of R have no part in what is not known of the orbit: c = 0."""
        self._past[self._slot] = 0.0

    def add_drift(self, ticks: int) -> None:
        """Add what the random walk of R does in some ticks."""
        self._covariances += ticks * self._drift
        size = len(self._drift)
        self._covariances.reshape(-1, size**2)[:, :: size + 1] += ticks * self._diagonal

    def traces(self) -> Vector:
        """Give the trace of P of every group, shape (groups,)."""
        taken = np.einsum("bgk,bgk->g", self._taken, self._past)
        return np.trace(self._covariances, axis1=1, axis2=2) + taken

    def widen(self, factors: Vector) -> None:
        """Multiply P of every group by its factor, shape (groups,)."""
        self._covariances *= factors[:, None, None]
        self._taken *= factors[:, None]

    def column(self, number: int) -> Vector:
        """Give one coefficient of every mode, shape (n,)."""
        return self._rows[:, number] + self._past[:, :, number].ravel() @ self._worth_rows

    def rows(self) -> Vector:
        """Give the coefficients of every mode, shape (n, k)."""
        self._add_all_terms()
        return self._rows.copy()

    def covariances(self, size: int) -> tuple[Vector, ...]:
        """Give the covariance of the first coefficients in every group, each (size, size)."""
        self._add_all_terms()
        return tuple(0.5 * (part + part.T) for part in self._covariances[:, :size, :size])

    def _add_all_terms(self) -> None:
        if self._waiting:
            for slot in range(_BLOCK):
                self._add_terms(slot)
            self._waiting = False

    def _add_terms(self, slot: int) -> None:
        """Add the terms to the rows of P₀ and θ̂₀ whose turn it is."""
        for rows, terms, past in self._turns[slot]:
            rows += terms.T @ past
            terms[:] = 0.0
