"""Effects on devices: correctors, BPMs, and pairs of either."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, cast

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, Law, PairLaw, Signals
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class ActuatorKind(EffectKind):
    """An effect on what correctors make of their setpoints, each corrector for itself.

    One with the target `ring` strikes all correctors at once and has no place: `drive` gets every
    column, and `simulate` no places.

    Attributes:
        proposes: Whether `hints` has any.
        fresh: Whether it has to be followed anew from where it begins, as `DeviceLaw` says.
    """

    target = "corrector"
    proposes: ClassVar[bool] = False
    fresh: ClassVar[bool] = False

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

    def laws(self, signals: Signals) -> Sequence[Law]:
        """Currents beyond the setpoints, each along the response of its corrector."""
        layout = signals.record.layout

        def course(values: Values, given: Signals) -> tuple[Matrix, ...]:
            return (self.drive(given.currents, values, given.record) - given.currents,)

        def first(values: Values, given: Signals) -> Matrix:
            beginning = given.currents.reshape(1, -1)  # each row of each one for itself
            rows = len(given.currents)
            wide = {name: np.tile(one, rows) for name, one in values.items() if np.ndim(one)}
            every = cast(Values, {**values, **wide})
            lost = self.drive(beginning, every, given.record.rows(0, 1)) - beginning
            return lost.reshape(given.currents.shape)

        def lacks(values: Values, given: Signals, onset: int) -> str:
            late = given.since(onset)
            return self.lacks(late.currents, values, late.record)

        def some(given: Signals, columns: Indices) -> Signals:
            return replace(given, currents=given.currents[:, columns])

        names = tuple(layout.correctors.label(i) for i in range(len(layout.correctors)))
        groups = layout.correctors.groups()
        return (
            DeviceLaw(
                (layout.response,), course, names, groups,
                first=first, driven=True, fresh=self.fresh, some=some, many=self.many, lacks=lacks,
            ),
        )  # fmt: skip

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """Tell what a record does not show of the law that makes it this one, and no simpler one.

        A limit that nothing ever gets below is a current that stands still, whatever it is called.

        Args:
            setpoints: Of the devices that it strikes, since it began, shape (N, k) [A].
            values: All parameters.
            record: Of these rows.

        Returns:
            The end of a sentence; empty: it lacks nothing.
        """
        return ""

    @property
    def many(self) -> Callable[[Sequence[Values], Signals], Matrix] | None:
        """Courses for several sets of values at once, where that is quicker; see `DeviceLaw`."""
        return None

    def proposed(
        self, currents: Matrix, pull: Callable[[], Matrix], record: Record
    ) -> Sequence[Values]:
        """What `hints` proposes, of kinds that have any."""
        return self.hints(currents, pull(), record) if self.proposes else ()

    def hints(self, setpoints: Matrix, pull: Matrix, record: Record) -> Sequence[Values]:
        """Propose values to scan beside `grid`, from what pulls at the likelihood.

        For effects whose likelihood is too spiky for any grid; by default there are none.

        Args:
            setpoints: As for `drive`, of all correctors, shape (N, m) [A].
            pull: ∂log L/∂current under the causes so far, shape (N, m) [1/A].
            record: As for `drive`.
        """
        return ()


class SteppingKind(ActuatorKind):
    """One whose memory is followed row by row: many values at once are then as quick as one."""

    fresh = True

    @abstractmethod
    def drive_each(
        self, setpoints: Matrix, values: Mapping[str, float | Vector], record: Record
    ) -> Matrix:
        """Tell the currents of columns that may have values of each one's own.

        Args:
            setpoints: Shape (N, k) [A].
            values: All parameters, each a number or of shape (k,).
            record: As for `drive`.
        """

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Follow, row by row."""
        return self.drive_each(setpoints, values, record)

    @property
    def many(self) -> Callable[[Sequence[Values], Signals], Matrix]:
        """Courses for several sets of values, one beside the other."""

        def beside(sets: Sequence[Values], given: Signals) -> Matrix:
            devices = given.currents.shape[1]
            wide = np.tile(given.currents, (1, len(sets)))
            values = {name: np.repeat([one[name] for one in sets], devices) for name in sets[0]}
            return self.drive_each(wide, values, given.record) - wide

        return beside


class SensorKind(EffectKind):
    """An effect on what BPMs tell of the orbit, each BPM for itself.

    Attributes:
        undoable: Whether readings tell what would have been read without it: see `restore`.
        periodic: Whether it is a wave of a frequency, as of `SourceKind`.
    """

    target = "bpm"
    undoable: ClassVar[bool] = True
    periodic: ClassVar[bool] = False

    def laws(self, signals: Signals) -> Sequence[Law]:
        """What each BPM makes of the predicted orbit beyond it."""
        layout = signals.record.layout

        def course(values: Values, given: Signals) -> tuple[Matrix, ...]:
            if not self.parameters:  # it can be undone without a choice, and so is told exactly
                return (undone(values, given, np.arange(len(layout.bpms)))[0],)
            return (self.distort(given.orbit, values, given.record) - given.orbit,)

        def undone(values: Values, given: Signals, columns: Indices) -> tuple[Matrix, Vector]:
            record = given.record
            read = record.readings[:, columns]
            restored, widened = self.restore(read, values, record)
            return read - restored, widened

        def lacks(values: Values, given: Signals, onset: int) -> str:
            return self.lacks(values, given.since(onset).record)

        def some(given: Signals, columns: Indices) -> Signals:
            return replace(given, orbit=given.orbit[:, columns])

        names = tuple(layout.bpms.label(i) for i in range(len(layout.bpms)))
        return (
            DeviceLaw(
                (np.eye(len(names)),), course, names, layout.bpms.groups(),
                periodic=self.periodic, undone=undone if self.undoable else None,
                some=some if self.parameters else None, lacks=lacks,
            ),
        )  # fmt: skip

    def lacks(self, values: Values, record: Record) -> str:
        """Tell what a record does not show of the law, as `ActuatorKind.lacks` does.

        Args:
            values: All parameters.
            record: Of the rows since it began.
        """
        return ""

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Undo the effect, if it is undoable: what would have been read without it.

        Args:
            readings: As read, of k BPMs, shape (N, k) [m].
            values: All parameters.
            record: Time, stretches, period, auxiliary channels and all else.

        Returns:
            Readings without the effect, shape (N, k) [m], and log |∂restored/∂reading| summed
            over the k BPMs, of every row, shape (N,).
        """
        raise NotImplementedError(f"{self.id} is not undone in the readings")

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

    def laws(self, signals: Signals) -> Sequence[Law]:
        """What two columns mix of each other."""
        layout = signals.record.layout
        of_bpms = self.target == "bpm"
        devices = layout.bpms if of_bpms else layout.correctors
        patterns = np.eye(len(devices)) if of_bpms else layout.response

        def mixing(values: Values) -> Matrix:
            matrices = self.matrices(layout, values)
            return np.eye(2) - np.linalg.inv(matrices) if of_bpms else matrices - np.eye(2)

        names = tuple(devices.label(i) for i in range(len(devices)))
        courses = signals.record.readings if of_bpms else signals.currents
        pairs = self.pairs(layout)
        return (PairLaw(patterns, courses, pairs, mixing, names, self.struck(pairs), of_bpms),)

    def struck(self, pairs: Indices) -> Sequence[tuple[int, ...]]:
        """Columns of the devices at fault at every pair, (P, 2): those of both, by default."""
        return [tuple(one) for one in pairs.tolist()]

    def matrices(self, layout: Layout, values: Values) -> Matrix:
        """Shape (P, 2, 2): `matrix` of every pair of `pairs`, in its order.

        They are all alike by default. An effect that mixes what the columns do, and not what is
        set (kicks and not amperes, when calibrations differ), tells it here.
        """
        return np.broadcast_to(self.matrix(values), (len(self.pairs(layout)), 2, 2))
