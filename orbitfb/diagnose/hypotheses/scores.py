"""Pull and information of device laws, from one spectrum of courses."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_solve

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.row_sums import OwnError, Rows
from orbitfb.diagnose.likelihood.errors import variances
from orbitfb.diagnose.likelihood.seen import Beside, Seen, positive, products
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, OwnValues
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalPriors, NormalTerms
from orbitfb.estimation.priors import SAMPLED, SHARES
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Scorer:
    """What a workspace says of columns pattern ⊗ course.

    Args:
        space: The record, its floor and what was accepted.
        pulled: Ω z with healthy errors marginalised, shape (T, n) [1/m].
        rows: The same from row to row instead of by frequency, each λ for itself.
        errors: The healthy errors, as the residual pulls at them.
        priors: The same, factored.
        modes: That part walk and noise, shape (n, n) [1/m].
        patterns: Of the healthy errors in these modes, shape (n, P).
        inverse: Mean inverse variance of every mode in every band, shape (B, n).
        weights: 1/(q + λ) of every mode at every frequency, shape (T, n).
        members: Frequencies of every band.
        sample: Frequencies that stand for all where values are ranked, and for how many each.
        kept: What patterns see, by their identity.
        nearby: Errors of the devices of a kind, by the kind.
        usual: The healthy error of each of them, by the kind.
        smaller: The healthy errors as they are, and as they may be once a cause is known.
    """

    space: Workspace
    pulled: Matrix
    rows: Rows
    errors: NormalTerms
    priors: NormalPriors
    modes: Single
    patterns: Single
    inverse: Single
    weights: Single
    members: tuple[Indices, ...]
    sample: tuple[Indices, Vector]
    kept: dict[int, Seen] = field(default_factory=dict)
    nearby: dict[str, Beside | None] = field(default_factory=dict)
    usual: dict[str, OwnError | None] = field(default_factory=dict)
    smaller: list[NormalPriors] = field(default_factory=list)

    @classmethod
    def of(cls, space: Workspace) -> "Scorer":
        """Weigh what a workspace leaves."""
        errors, priors, transform = space.errors, space.priors, space.transform
        left = space.residual - space.terms.contribution(priors.mean(errors.pull))
        pulled = space.noise.pull(left, transform)
        return cls(
            space, pulled, Rows.of(left, space.noise, transform), errors, priors,
            space.noise.modes.astype(np.float32),
            (space.noise.modes.T @ space.terms.patterns).astype(np.float32),
            space.noise.inverse_variance(transform).astype(np.float32),
            (1.0 / space.noise.variance(transform)).astype(np.float32),
            tuple(transform.members(band) for band in range(len(transform.count))),
            transform.sample(SAMPLED),
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

    def seen(self, patterns: Matrix) -> Seen:
        """What patterns see of the residual; kept, as many values of a law share their patterns."""
        known = self.kept.get(id(patterns))
        if known is None:
            known = self.kept[id(patterns)] = Seen.of(
                patterns, self.space.noise.modes, self.inverse, self.pulled
            )
        return known

    def score(
        self, patterns: tuple[Matrix, ...], spectra: Sequence[Single]
    ) -> tuple[Vector, Matrix]:
        """Pull (D,) and information (D, D) of devices; healthy errors are not taken off the latter.

        Args:
            patterns: Blocks of shape (n, D) [m].
            spectra: Transformed steps of their courses, blocks of shape (T, D) or (T, 1).
        """
        seen = [self.seen(one) for one in patterns]
        count = patterns[0].shape[1]
        pull, information = np.zeros(count), np.zeros((count, count))
        parts = [[spectrum[rows] for rows in self.members] for spectrum in spectra]
        for one, spectrum, mine in zip(seen, spectra, parts, strict=True):
            pull += np.einsum("fd,fd->d", one.pulled, np.broadcast_to(spectrum, one.pulled.shape))
            for other, theirs in zip(seen, parts, strict=True):
                precision = (
                    one.precision
                    if other is one
                    else [(one.modes * weight) @ other.modes.T for weight in self.inverse]
                )
                for weight, left, right in zip(precision, mine, theirs, strict=True):
                    information += weight * (left.T @ right)
        return pull, information

    def marginal(
        self,
        kind: EffectKind,
        patterns: tuple[Matrix, ...],
        spectra: Sequence[Single],
        information: Matrix,
    ) -> Matrix:
        """Information of devices with the errors of the same devices marginalised, shape (D, D).

        Args:
            kind: Whose devices they are.
            patterns: Blocks of shape (n, D) [m].
            spectra: As for `score`.
            information: That `score` gave.
        """
        own = self.beside_of(kind.target)
        if own is None:
            return information
        cross = np.zeros((len(own.scale), len(information)))
        for pattern, spectrum in zip(patterns, spectra, strict=True):
            seen = self.seen(pattern)
            for number, rows in enumerate(self.members):
                weight = (own.modes * self.inverse[number]) @ seen.modes.T
                cross += weight * (own.spectrum[rows].T @ spectrum[rows])
        solved = cho_solve(own.factor, own.scale[:, None] * cross)
        return information - (own.scale[:, None] * cross).T @ solved

    def beside_of(self, target: str) -> Beside | None:
        """The healthy errors, and values of accepted causes, of devices of a kind; kept."""
        if target not in self.nearby:
            columns = [
                np.arange(block.columns.start, block.columns.stop)
                for block in self.space.blocks
                if block.kind.target == target
            ]
            chosen = np.concatenate(columns) if columns else np.zeros(0, np.intp)
            chosen = chosen[self.errors.variance[chosen] > 0.0]
            self.nearby[target] = (
                Beside.of(self.space, self.errors, chosen) if len(chosen) else None
            )
        return self.nearby[target]

    def together(
        self, patterns: Matrix, spectrum: Single, groups: Sequence[Indices]
    ) -> tuple[float, Vector]:
        """Information of all devices, and of groups (G,), from some frequencies of each band."""
        if spectrum.shape[1] == 1:
            spectrum = np.broadcast_to(spectrum, (len(spectrum), patterns.shape[1]))
        rows, share = self.sample
        modes, some, weight = self.seen(patterns).modes, spectrum[rows], self.weights[rows]

        def of(seen: Single) -> float:
            return float(share @ np.sum(seen * seen * weight, axis=1, dtype=np.float64))

        return of(some @ modes), np.array([of(some[:, one] @ modes[one]) for one in groups])

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

    def is_usual(self, kind: EffectKind) -> bool:
        """Whether healthy devices have it, up to a limit."""
        return any(block.kind is kind and not block.accepted for block in self.space.blocks)

    def own_error(self, kind: EffectKind, devices: Indices | None = None) -> OwnError | None:
        """The healthy error of the devices of a kind; None where they have none.

        Args:
            kind: Whose devices they are.
            devices: Numbers of some of them; None: all.
        """
        if kind.target not in self.usual:
            self.usual[kind.target] = self._own_error(kind.target)
        own = self.usual[kind.target]
        return own if own is None or devices is None else own.of(devices)

    def _own_error(self, target: str) -> OwnError | None:
        terms = self.space.terms
        for block in self.space.blocks:
            variance = self.errors.variance[block.columns]
            if block.kind.target != target or block.accepted or not np.any(variance):
                continue
            spectrum = terms.spectrum[:, block.columns]
            return OwnError(
                block.columns.start, spectrum,
                self.rows.whitened(self.space.transform.turn(spectrum)), variance,
                np.diag(self.errors.information)[block.columns],
            )  # fmt: skip
        return None

    def apart(
        self, law: DeviceLaw, values: OwnValues, own: OwnError | None
    ) -> tuple[Vector, Vector]:
        """Pull and information of every device for itself, shape (D,) each.

        Args:
            law: Of the devices.
            values: Of its parameters.
            own: Healthy error of the devices, which is marginalised.
        """
        courses = self.space.courses
        spectra, powers = courses.spectra(law, values), courses.powers(law, values)
        crosses = powers if own is None else courses.powers(law, values, (own.first, own.spectrum))
        count = law.patterns[0].shape[1]
        pull, information, cross = np.zeros(count), np.zeros(count), np.zeros(count)
        for pattern, spectrum, power, beside in zip(
            law.patterns, spectra, powers, crosses, strict=True
        ):
            seen = self.seen(pattern)
            pull += np.einsum("td,td->d", seen.pulled, np.broadcast_to(spectrum, seen.pulled.shape))
            information += np.sum(seen.own * power, axis=0)
            cross += np.sum(seen.own * beside, axis=0)
        return pull, information if own is None else own.marginal(information, cross)
