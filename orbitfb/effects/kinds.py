"""The kinds of effects: what each must tell so that it can be simulated, found and estimated.

A record is explained by  reading = sense(R · actuate(setpoints) + disturbance) + noise.  Every
kind of effect changes one link of that chain, device by device, and tells its change for a whole
record at once. From that one hook follow both the scan over all places (with the predicted orbit
in the place of the readings, because the noise of a reading is in the action that it caused) and
the exact likelihood of a record with the effect in it.

How a kind joins the plant of the simulator is told by `simulate`, tick by tick; that is written
separately on purpose, so that recovering what was simulated tests both.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.effects.layout import Layout
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

Stage = Literal["sensor", "actuator", "optics", "disturbance", "noise", "timing"]
Target = Literal["bpm", "corrector", "quadrupole", "sextupole", "source", "ring"]
Courses = NDArray[np.float64]
"""Courses in time of P places: (N, P), (N, 1), or by plane (2, N, P)."""
Values = Mapping[str, float]
"""Values of the parameters by name, SI."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect.

    Args:
        name: As in `--effect id:name=value`.
        unit: SI unit, `1` for a ratio.
        low: Least value that makes sense.
        high: Largest value that makes sense.
        nominal: Value at which the effect is not there.
        typical: A size that occurs: width of the prior, and the default of `--effect`.
        description: For operators.
        log: Whether its size is known by order of magnitude only (grids are then logarithmic).
        rough: Whether the likelihood jumps as it moves, because it decides row by row what
            happens: it is then searched without derivatives.
        whole: Whether only whole numbers make sense.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    typical: float
    description: str
    log: bool = False
    rough: bool = False
    whole: bool = False


class EffectKind(ABC):
    """One physical effect. A subclass per file; give the class attributes and the hooks.

    Attributes:
        id: Kebab-case name.
        stage: Link of the chain that it changes.
        target: What it sits on; `source` is a quadrupole or corrector place that kicks the beam.
        parameters: In the order in which people would name them; the size comes first.
        title: A few words, beginning in lower case ("gain error of a BPM").
        sentence: What it means to an operator, one or two sentences.
        equation: How it acts, one line of plain text, with its source where there is one.
        linear: Name of the parameter in which the change of the prediction is (nearly)
            proportional to (value − nominal), so that its best value is found without a search;
            None when there is none: then `grid` is searched.
        confused_with: Ids of effects that a record may be unable to tell from it, and in
            `splits` what would (one line).
        collective: Whether it commonly strikes all devices of a cell, or of the ring, with one
            value: groups are then tried beside single devices.
        sudden: Whether it commonly begins in the middle of a record: onsets are then tried.
        grows: Whether it grows from nothing at `record.time` = 0. For an onset at t it must be
            given a record whose time is `np.maximum(time − t, 0)`; mixing would make a step of it.
        vanishes: Whether nothing is left of it when every parameter has its nominal value. An
            effect without parameters is either there or not, whatever this says; a stuck device
            has a parameter and is there all the same.
    """

    id: ClassVar[str]
    stage: ClassVar[Stage]
    target: ClassVar[Target]
    parameters: ClassVar[tuple[Parameter, ...]]
    title: ClassVar[str]
    sentence: ClassVar[str]
    equation: ClassVar[str]
    linear: ClassVar[str | None] = None
    confused_with: ClassVar[tuple[str, ...]] = ()
    splits: ClassVar[str] = ""
    collective: ClassVar[bool] = True
    sudden: ClassVar[bool] = True
    grows: ClassVar[bool] = False
    vanishes: ClassVar[bool] = True

    @abstractmethod
    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Make the effect as a part of the plant.

        Args:
            layout: Devices, model and period of the plant.
            places: Which devices: columns of the orbit or of the setpoints; for `quadrupole` and
                `sextupole` their positions among the ring's; for `source` positions among the
                places that `places_of` lists; for `ring` empty.
            values: All parameters, SI.
            rng: Its random numbers.
        """

    def unavailable(self, record: Record) -> str:
        """Say why this record cannot show the effect; empty when it can."""
        if self.target in ("quadrupole", "sextupole", "source") and record.layout.ring is None:
            return "needs a places table that knows the names of the record"
        return ""

    def grid(self, record: Record) -> Sequence[Values]:
        """Values to scan, coarse but dense enough that a local search finds the best one.

        With `linear` one set is enough: a small size of it. By default the first parameter runs
        logarithmically (or linearly) over its bounds in 9 steps, the others are typical.
        """
        typical = {p.name: p.typical for p in self.parameters}
        if not self.parameters:
            return (typical,)
        first = self.parameters[0]
        if self.linear is not None:
            return (typical,)
        if first.log:
            steps = np.geomspace(max(first.low, first.high * 1e-4), first.high, 9)
        else:
            steps = np.linspace(first.low, first.high, 9)
        return tuple({**typical, first.name: float(step)} for step in steps)


class ActuatorKind(EffectKind):
    """An effect on what correctors make of their setpoints, each corrector for itself.

    One with the target `ring` strikes all correctors at once and has no place: `drive` gets every
    column, and `simulate` no places.
    """

    target = "corrector"

    @abstractmethod
    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Tell the currents that act on the beam.

        Args:
            setpoints: In force at every row, of k correctors, shape (N, k) [A]; constant before
                the first row of a stretch (`record.starts`).
            values: All parameters.
            record: Time, stretches, period and all else.

        Returns:
            Currents in force at every row, shape (N, k) [A].
        """

    def hints(self, setpoints: Matrix, pull: Matrix, record: Record) -> Sequence[Values]:
        """Propose values to scan beside `grid`, from what pulls at the likelihood.

        For effects whose likelihood is too spiky for any grid; by default there are none.

        Args:
            setpoints: As for `drive`, of all correctors, shape (N, m) [A].
            pull: ∂log L/∂current under the causes so far, shape (N, m) [1/A].
            record: As for `drive`.
        """
        return ()


class SensorKind(EffectKind):
    """An effect on what BPMs tell of the orbit, each BPM for itself."""

    target = "bpm"

    @abstractmethod
    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Undo the effect: what would have been read without it.

        Args:
            readings: As read, of k BPMs, shape (N, k) [m].
            values: All parameters.
            record: Time, stretches, period, auxiliary channels and all else.

        Returns:
            Readings without the effect, shape (N, k) [m], and log |∂restored/∂reading| summed
            over the k BPMs, of every row, shape (N,).
        """

    @abstractmethod
    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Tell what the BPMs make of an orbit: the inverse of `restore`.

        The change of the prediction by the effect is distort(x̂) − x̂ with the predicted orbit x̂.
        (−(restore(x̂) − x̂) is the same to first order only: a flipped polarity would get the
        wrong sign, a latency the wrong tick.)

        Args:
            orbit: At k BPMs, shape (N, k) [m].
            values: All parameters.
            record: As for `restore`.

        Returns:
            Shape (N, k) [m].
        """


class SourceKind(EffectKind):
    """An effect that adds, for each of its places, an orbit of fixed shape times a course in time.

    Errors of quadrupoles, kicks, periodic disturbances, energy: everything of rank one per plane.
    A place that acts in both planes has one course for the rows of the x BPMs and one for those
    of the y BPMs (a gradient error acts with opposite signs): `orbitfb.effects.change` joins them.
    """

    target = "source"
    periodic: ClassVar[bool] = False
    """Whether it is `cosine` cos ωt + `sine` sin ωt of a `frequency` [Hz]: all frequencies are
    then scanned at once by a Fourier transform of the scores."""
    scattered: ClassVar[bool] = False
    """Whether all places have it at once, in normal sizes whose rms is the first parameter: a
    covariance Σ δ_p δ_pᵀ of the prediction, δ_p of place p at the first parameter's value."""

    @abstractmethod
    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Names of the P places that it may have (with the plane where that matters)."""

    @abstractmethod
    def patterns(self, layout: Layout) -> Matrix:
        """Orbit shape of every place, shape (n, P); of a place in both planes, both are filled."""

    @abstractmethod
    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Course of every place's amplitude.

        Args:
            values: All parameters.
            record: Time, period, auxiliary channels.
            currents: That act on the beam, shape (N, m) [A].
            orbit: Predicted orbit at the BPMs, without noise of the readings, shape (N, n) [m].

        Returns:
            Shape (N, P), or (N, 1) when it is the same for all places; or (2, N, P) when the
            planes differ: the first for the rows of the x BPMs, the second for those of y.
        """


class RingKind(EffectKind):
    """An effect on the whole ring: it has no place."""

    target = "ring"
    collective = False

    @abstractmethod
    def deflect(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Tell what it adds to the orbit, shape (N, n) [m]; arguments as for `drivers`."""


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

    @abstractmethod
    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Names of the P places that it may have."""

    @abstractmethod
    def patterns(self, layout: Layout) -> Matrix:
        """Shape b of every place, shape (n, P)."""

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
    """`always one`: z = 1 with the probability that is the first parameter, else 0; `normal`: z
    is normal at every row, of the standard deviation that is the first parameter; `sometimes
    normal`: with the probability that is the first parameter z is normal, of the standard
    deviation that is the second one, else 0."""
    per_bpm: ClassVar[bool] = False
    """Whether it strikes BPM by BPM (every column of `shapes` with its own z) or all at once."""

    @abstractmethod
    def shapes(self, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Change of the prediction by a strike of strength 1, shape (N, n) [m per unit of z]."""


class PairKind(EffectKind):
    """An effect that ties two columns: swapped, coupled or rolled devices.

    `bpm` pairs change readings, `corrector` pairs change currents, by a 2 × 2 matrix.
    """

    @abstractmethod
    def pairs(self, layout: Layout) -> Indices:
        """Ordered pairs of columns that may be tied, shape (P, 2)."""

    @abstractmethod
    def matrix(self, values: Values) -> Matrix:
        """Shape (2, 2): (first, second) as acted on = matrix @ (first, second) as wanted.

        Wanted are true positions for `bpm` (and acted on the readings), setpoints for
        `corrector` (and acted on the currents).
        """

    def matrices(self, layout: Layout, values: Values) -> Matrix:
        """Shape (P, 2, 2): `matrix` of every pair of `pairs`, in its order.

        They are all alike by default. An effect that mixes what the columns do, and not what is
        set (kicks and not amperes, when calibrations differ), tells it here.
        """
        return np.broadcast_to(self.matrix(values), (len(self.pairs(layout)), 2, 2))
