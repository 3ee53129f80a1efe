"""What a workspace leaves, weighed: what fields and columns are worth, the errors marginalised."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.errors import variances
from orbitfb.diagnose.likelihood.seen import positive, products
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.evidence import NormalPriors, NormalTerms
from orbitfb.estimation.priors import SHARES
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """What a workspace says of fields, and of columns pattern ⊗ course.

    Args:
        space: The record, its floor and what was accepted.
        left: What healthy errors at their mean leave, shape (T, n) [m].
        pulled: Ω z of it, shape (T, n) [1/m].
        errors: The healthy errors, as the residual pulls at them.
        priors: The same, factored.
        modes: That part walk and noise, shape (n, n) [1/m].
        patterns: Of the healthy errors in these modes, shape (n, P).
        inverse: Mean inverse variance of every mode in every band, shape (B, n).
        weights: 1/(q + λ) of every mode at every frequency, shape (T, n).
        members: Frequencies of every band.
        smaller: The healthy errors as they are, and as they may be once a cause is known.
    """

    space: Workspace
    left: Matrix
    pulled: Matrix
    errors: NormalTerms
    priors: NormalPriors
    modes: Single
    patterns: Single
    inverse: Single
    weights: Single
    members: tuple[Indices, ...]
    smaller: list[NormalPriors] = field(default_factory=list, init=False)

    @classmethod
    def of(cls, space: Workspace) -> Self:
        """Weigh what a workspace leaves."""
        transform, left = space.transform, space.left
        return cls(
            space, left, space.noise.pull(left, transform), space.errors, space.priors,
            space.noise.modes.astype(np.float32),
            (space.noise.modes.T @ space.terms.patterns).astype(np.float32),
            space.noise.inverse_variance(transform).astype(np.float32),
            (1.0 / space.noise.variance(transform)).astype(np.float32),
            tuple(transform.members(band) for band in range(len(transform.count))),
        )  # fmt: skip

    def evaluate(self, fields: "Sequence[Matrix | Single]") -> tuple[Vector, Matrix]:
        """Pull and information of whole fields, healthy errors marginalised.

        What the errors take of a field is told by band, as their own information is: else a field
        that they can nearly make would seem to have none left, or less than none.

        Args:
            fields: Spectra of what each adds to the readings, shape (T, n) each [m].

        Returns:
            a, shape (k,), and H, shape (k, k).
        """
        pull = np.array([np.einsum("tn,tn->", self.pulled, one, dtype=float) for one in fields])
        seen = [one.astype(np.float32) @ self.modes for one in fields]
        information = products([one * self.weights for one in seen], seen)
        if not len(self.priors.used):
            return pull, information
        used = self.errors.variance > 0.0
        weight = self.inverse[self.space.transform.band]
        weighed = [one * weight for one in seen]
        by_band = products(weighed, seen)
        cross = [self.space.terms.pull(one, used, self.patterns) for one in weighed]
        left = positive(self.priors.beyond(by_band, np.stack(cross, axis=1)))
        scale = np.sqrt(np.diag(information) / np.maximum(np.diag(by_band), 1e-300))
        return pull, scale[:, None] * left * scale

    def likelihood(self, field: "Matrix | Single") -> float:
        """Log likelihood of a whole field over none, healthy errors marginalised [nats]."""
        pull, information = self.evaluate([field])
        return float(pull[0] - 0.5 * information[0, 0])

    def columns(self, patterns: Sequence[Matrix], spectrum: Single) -> tuple[Vector, Matrix]:
        """Pull and information of devices of a size each, healthy errors marginalised.

        Args:
            patterns: Of every block of columns, each (n, D) [m]; a device has one in each.
            spectrum: Transformed steps of the courses, block by block, shape (T, k); again block by
                block for every further course that the devices may have, L in all.

        Returns:
            a, shape (L D,), and H, shape (L D, L D).
        """
        whole, devices = np.hstack(patterns), patterns[0].shape[1]
        pull, information = self._columns(whole, spectrum)
        shape = (len(pull) // whole.shape[1], len(patterns), devices)
        pull = pull.reshape(shape).sum(axis=1).ravel()
        information = information.reshape(*shape, *shape).sum(axis=(1, 4))
        return pull, information.reshape(len(pull), len(pull))

    def each(self, patterns: Matrix, spectrum: Single) -> tuple[Vector, Vector]:
        """Pull and information of fields, each for itself, healthy errors marginalised.

        Args:
            patterns: That every field has, shape (n, P) [m].
            spectrum: Transformed steps of the courses of R fields along each, field by field,
                shape (T, R P).

        Returns:
            a and H, shape (R,) each.
        """
        count = patterns.shape[1]
        along = self.pulled.astype(np.float32) @ patterns.astype(np.float32)
        courses = spectrum.reshape(len(spectrum), -1, count)
        pull = np.einsum("tp,trp->r", along, courses, dtype=float)
        seen = (patterns.T @ self.space.noise.modes).astype(np.float32)
        information = np.zeros(len(pull))
        for weight, rows in zip(self.inverse, self.members, strict=True):
            part = courses[rows]
            information += np.sum(part * (part @ ((seen * weight) @ seen.T)), axis=(0, 2))
        if not len(self.priors.used):
            return pull, information
        cross = self._beside(patterns, spectrum).reshape(-1, len(pull), count).sum(axis=2)
        return pull, np.maximum(information - self.priors.taken(cross), 0.0)

    def _columns(self, patterns: Matrix, spectrum: Single) -> tuple[Vector, Matrix]:
        count = patterns.shape[1]
        along = self.pulled.astype(np.float32) @ patterns.astype(np.float32)
        courses = spectrum.reshape(len(spectrum), -1, count)
        pull = np.einsum("tp,trp->rp", along, courses, dtype=float).ravel()
        seen = (patterns.T @ self.space.noise.modes).astype(np.float32)
        turns = courses.shape[1]
        information = np.zeros((turns, count, turns, count))
        for weight, rows in zip(self.inverse, self.members, strict=True):
            part = spectrum[rows]
            product = (part.T @ part).reshape(information.shape)
            information += ((seen * weight) @ seen.T)[:, None] * product
        information = information.reshape(len(pull), len(pull))
        if not len(self.priors.used):
            return pull, information
        return pull, positive(self.priors.beyond(information, self._beside(patterns, spectrum)))

    def _beside(self, patterns: Matrix, spectrum: Single) -> Matrix:
        """Information between the healthy errors and columns, shape (k, k')."""
        space, used = self.space, self.errors.variance > 0.0
        return space.terms.cross(space.noise, space.transform, patterns, spectrum, used)

    def eased(self, field: Matrix) -> float:
        """Log evidence gained if the healthy errors are smaller once a cause is known [nats].

        Without the cause they stand in for it as far as their limits allow; a record whose cause
        is known shows how small they are.

        Args:
            field: Spectrum of what the cause adds to the readings, shape (T, n) [m].
        """
        space = self.space
        if not len(self.errors.used):
            return 0.0
        if not self.smaller:
            self.smaller.extend(
                NormalPriors.of(space.known.information, np.maximum(share**2 * usual, space.single))
                for usual in [variances(space.blocks, space.shares, len(space.terms))]
                for share in SHARES[::-1]
            )
        pulled = space.noise.pull(space.residual - field, space.transform)
        pull = space.terms.pull(pulled, self.errors.variance > 0.0)
        gains = [
            max(found) - found[0]
            for found in (
                [one.evidence(its) for one in self.smaller] for its in (pull, self.errors.pull)
            )
        ]
        return max(gains[0] - gains[1], 0.0)
