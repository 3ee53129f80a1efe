"""Pull and information of device laws, from one spectrum of courses."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_solve

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.row_sums import OwnError, Rows
from orbitfb.diagnose.likelihood.seen import Beside, Seen
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.effects.kinds import EffectKind, OwnValues
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.priors import SAMPLED
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Scorer(Weighed):
    """What a workspace says of devices: quickly, to rank them, and row by row.

    Args:
        kept: What patterns see, by their identity.
        nearby: Errors of the devices of a kind, by the kind.
        usual: The healthy error of each of them, by the kind.
        late: What is left from row to row, once it was asked for.
        others: How what the errors of other devices leave pulls, by the kind of these.
    """

    kept: dict[int, Seen] = field(default_factory=dict, init=False)
    nearby: dict[str, Beside | None] = field(default_factory=dict, init=False)
    usual: dict[str, OwnError | None] = field(default_factory=dict, init=False)
    late: list[Rows] = field(default_factory=list, init=False)
    others: dict[str, Matrix] = field(default_factory=dict, init=False)

    @property
    def rows(self) -> Rows:
        """What is left from row to row instead of by frequency, each λ for itself."""
        if not self.late:
            self.late.append(Rows.of(self.left, self.space.noise, self.space.transform))
        return self.late[0]

    def beside_others(self, target: str) -> Matrix:
        """Ω z of what healthy errors of other devices leave, shape (T, n) [1/m]; kept.

        Args:
            target: Devices whose own errors are left in.
        """
        if target not in self.others:
            space = self.space
            sizes = self.priors.mean(self.errors.pull)
            for block in space.blocks:
                if block.of_devices(target):
                    sizes[block.columns] = 0.0
            left = space.residual - space.terms.contribution(sizes)
            self.others[target] = space.noise.pull(left, space.transform)
        return self.others[target]

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
                if block.of_devices(target)
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
        rows, share = self.space.transform.sample(SAMPLED)
        modes, some, weight = self.seen(patterns).modes, spectrum[rows], self.weights[rows]

        def of(seen: Single) -> float:
            return float(share @ np.sum(seen * seen * weight, axis=1, dtype=np.float64))

        return of(some @ modes), np.array([of(some[:, one] @ modes[one]) for one in groups])

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
            if not block.of_devices(target) or block.accepted or not np.any(variance):
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
