"""Effects without a course in time that could be known: noise, and what strikes at random."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import EventLaw, Law, RandomLaw, Signals
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class NoiseKind(EffectKind):
    """An effect that has no course in time that could be known: it adds or takes randomness.

    Per place it adds κ b bᵀ to the covariance of the readings' innovations, white in time; the
    size κ is found in closed form. `size` and `variance` turn κ into the first parameter and back.
    A group of places adds the sum of its κ b bᵀ.
    """

    stage = "noise"
    lag: ClassVar[int] = 0
    """Ticks between the two readings whose covariance gains κ b bᵀ."""
    colour: ClassVar[Literal["white", "walk"]] = "white"
    """`white`: κ b bᵀ is added to the covariance of the readings. `walk`: to that of the steps
    that the orbit makes from tick to tick (each of them stays), κ per tick; in `variance` and
    `size` the usual rms amplitude of a place's own steps then stands for the reading noise. Of a
    kind on the `ring` all places have it together."""
    rare: ClassVar[bool] = False
    """Whether the added randomness comes in few large strokes (its steps have heavy tails) rather
    than a little at every tick."""

    relative: ClassVar[bool] = False
    """Whether its parameters are ratios to what the same devices have without it."""

    def laws(self, signals: Signals) -> Sequence[Law]:
        """Patterns whose amplitude is random."""
        layout = signals.record.layout
        groups = layout.bpms.groups() if self.target == "bpm" and self.collective else {}
        return (
            RandomLaw(
                patterns=self.patterns(layout),
                names=self.places_of(layout),
                groups=groups,
                walk=self.colour == "walk",
                together=self.target == "ring",
                rare=self.rare,
                relative=self.relative,
                lag=self.lag,
                size=self.size,
                strokes=self.of_strokes,
            ),
        )

    def of_strokes(self, strokes: Vector) -> Values:
        """Parameters that rare strokes tell themselves, by the strokes of all steps, shape (T,)."""
        return {}

    @abstractmethod
    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Names of the P places that it may have."""

    @abstractmethod
    def patterns(self, layout: Layout) -> Matrix:
        """Shape b of every place, shape (n, P)."""

    def devices_at(self, layout: Layout, places: Sequence[int]) -> tuple[int, ...]:
        """A place may be a group of BPMs."""
        if self.target != "bpm":
            return tuple(places)
        struck = self.patterns(layout)[:, list(places)].any(axis=1)
        return tuple(int(one) for one in np.flatnonzero(struck))

    @abstractmethod
    def variance(self, values: Values, reading_noise: float) -> float:
        """κ [m² in the units of b²] of given parameters, for BPMs of a given noise rms [m]."""

    @abstractmethod
    def size(self, variance: float, reading_noise: float) -> float:
        """First parameter that belongs to κ; the inverse of `variance`."""

    def spectrum(
        self, values: Values, reading_noise: float, turn: NDArray[np.complex128]
    ) -> Vector:
        """Spectrum of what it adds to the steps of the readings from row to row, per b bᵀ.

        Args:
            values: All parameters.
            reading_noise: As for `variance` [m].
            turn: exp(−iω) of every frequency, shape (F,).

        Returns:
            κ(ω), shape (F,).
        """
        size = self.variance(values, reading_noise)
        if self.colour == "walk":
            return np.full(len(turn), size)
        return size * np.abs(1.0 - turn) ** 2


class LatentKind(EffectKind):
    """An effect that strikes single ticks at random: nobody knows which.

    If it strikes at row k with strength z the prediction of that row changes by z · shapes[k].
    """

    target = "ring"
    collective = False
    sudden = False
    strength: ClassVar[Literal["always one", "normal", "sometimes normal"]]
    """`always one`: z = 1 with the probability that is the first parameter, else 0, and strikes
    in a row adds up, as a value is held until the next one comes; `normal`: z is normal at every
    row, of the standard deviation that is the first parameter; `sometimes normal`: with the
    probability that is the first parameter z is normal, of the standard deviation that is the
    second one, else 0."""
    per_bpm: ClassVar[bool] = False
    """Whether it strikes BPM by BPM (every column of `shapes` with its own z) or all at once."""

    def laws(self, signals: Signals) -> Sequence[Law]:
        """What a strike changes, row by row."""
        record, layout = signals.record, signals.record.layout
        devices = layout.bpms if self.target == "bpm" else layout.correctors
        parts = {} if self.target == "ring" else devices.groups()
        return (
            EventLaw(
                shapes=self.shapes(record, signals.currents, signals.orbit),
                parts=parts,
                moves=self.moves(record, signals.currents),
                often=self.strength == "normal",
                single=self.per_bpm,
            ),
        )

    @abstractmethod
    def shapes(self, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Change of the prediction by a strike of strength 1, shape (N, n) [m per unit of z]."""

    def moves(self, record: Record, currents: Matrix) -> Matrix:
        """Change of every corrector's current by it, shape (N, m) [A per unit of z].

        Of an effect on correctors, which may strike some of them together; else nothing.
        """
        return np.zeros_like(currents)
