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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.laws import Law, Signals
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

Stage = Literal["sensor", "actuator", "optics", "disturbance", "noise", "timing"]
Target = Literal["bpm", "corrector", "quadrupole", "sextupole", "source", "ring"]
CALIBRATION_ERROR = 0.01
"""Scatter of the gains of healthy BPMs and correctors, as their makers state it."""
HEALTHY_CHANGE = 0.03
"""Error of a healthy ring's response, rms over its own [1]. By hand: two measured responses of one
ring differ by 2 to 4 %."""

Values = Mapping[str, float]
"""Values of the parameters by name, SI."""

FIRST_STATE = "first_state"
"""Beside the parameters of a kind that remembers: its state in the first row, from −1 to 1."""

OwnValues = Mapping[str, float | Vector]
"""The same, some of them of every device's own, shape (D,)."""


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
        whole: Whether only whole numbers make sense.
        optional: Whether the law is complete without it: values may leave it out, and where it
            has its nominal value it is not fitted.
        meanings: What each value stands for, in words, where the values are choices (not fitted).
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    typical: float
    description: str
    log: bool = False
    whole: bool = False
    optional: bool = False
    meanings: Mapping[float, str] = field(default_factory=dict)


class EffectKind(ABC):
    """One physical effect. A subclass per file; give the class attributes and the hooks.

    Attributes:
        id: Kebab-case name.
        stage: Link of the chain that it changes.
        target: What it sits on; `source` is a quadrupole or corrector place that kicks the beam.
        parameters: In the order in which people would name them; the size comes first.
        title: A few words, beginning in lower case ("gain error of a BPM").
        sentence: What an operator sees, why, and what to check; short sentences.
        equation: How it acts, one line of plain text, with its source where there is one.
        linear: Name of the parameter in which the change of the prediction is (nearly)
            proportional to (value − nominal), so that its best value is found without a search;
            None when there is none: then `grid` is searched.
        homogeneous: Whether the change is (nearly) proportional to all parameters at once, each
            from its nominal value on: a size for each plane, say. The grid tells their ratio.
        confused_with: Ids of effects that a record may be unable to tell from it.
        splits: What would tell them apart, in sentences.
        also_called: Ids by which the same fault goes with another course in time; an answer lists
            them beside its own.
        collective: Whether it commonly strikes all devices of a cell, or of the ring, with one
            value: groups are then tried beside single devices.
        sudden: Whether it commonly begins in the middle of a record: onsets are then tried.
        grows: Whether it grows from nothing at `record.time` = 0. For an onset at t it must be
            given a record whose time is `np.maximum(time − t, 0)`; mixing would make a step of it.
        elemental: Whether it acts on single elements of the response, which may be given one by
            one: see `with_elements`.
        remembers: Whether what it did before the record stays in it until its device has moved far:
            its courses then take `FIRST_STATE` beside the parameters.
        delays: Rows by which a free answer of such devices may be delayed while the noise of the
            record is estimated.
    """

    id: ClassVar[str]
    stage: ClassVar[Stage]
    target: ClassVar[Target]
    parameters: ClassVar[tuple[Parameter, ...]]
    title: ClassVar[str]
    sentence: ClassVar[str]
    equation: ClassVar[str]
    linear: ClassVar[str | None] = None
    homogeneous: ClassVar[bool] = False
    confused_with: ClassVar[tuple[str, ...]] = ()
    splits: ClassVar[str] = ""
    also_called: ClassVar[tuple[str, ...]] = ()
    collective: ClassVar[bool] = True
    sudden: ClassVar[bool] = True
    grows: ClassVar[bool] = False
    elemental: ClassVar[bool] = False
    delays: ClassVar[int] = 0
    remembers: ClassVar[bool] = False

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """Parameters with which its change scales: one score tells the best of them."""
        return tuple(p for p in self.parameters if self.homogeneous or p.name == self.linear)

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

    def with_elements(
        self, layout: Layout, places: Indices, elements: Mapping[str, float]
    ) -> Effect:
        """Make the effect with given errors of single elements of the response.

        Args:
            layout: Devices, model and period of the plant.
            places: Which devices.
            elements: Error of each element [m/A], by the name of the other device; `NAME (x)`
                where a ring has both planes.

        Raises:
            ConfigError: A name is none of the ring's.
        """
        raise NotImplementedError(f"{self.id} does not act on single elements")

    def healthy_scatter(self, layout: Layout) -> Vector | None:
        """Standard deviation of `linear` up to which a healthy ring has it, of every device.

        None where a healthy ring has none.
        """
        return None

    def refinement(self, signals: Signals) -> Matrix | None:
        """What a ring as the table of places has it adds to the linear model, shape (N, n) [m].

        Such a refinement is not named while it is small. None: nothing.
        """
        return None

    def together(self, layout: Layout, sizes: Sequence[Vector]) -> Matrix | None:
        """Change of the response by errors of all devices that act on one another, (n, m) [m/A].

        Args:
            layout: Devices and ring.
            sizes: Of `linear`, of every device, block by block of its law, shape (D,) each.

        Returns:
            What they all do; None: that is the sum of what each does alone.
        """
        return None

    @abstractmethod
    def laws(self, signals: Signals) -> Sequence[Law]:
        """Tell what it adds to the readings of a record, in forms that the diagnosis knows."""

    def devices_at(self, layout: Layout, places: Sequence[int]) -> tuple[int, ...]:
        """Devices that are struck where places of its law are; the same as a rule."""
        return tuple(places)

    def unavailable(self, record: Record) -> str:
        """Say why this record cannot show the effect; empty when it can."""
        if self.target in ("quadrupole", "sextupole") and record.layout.ring is None:
            return "needs a places table that knows the names of the record"
        return ""

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Parameters on which the record bears; the others keep the values they have."""
        return self.parameters

    def set_by(self, values: Values, record: Record) -> tuple[Parameter, ...]:
        """Parameters that values choose: an optional one at its nominal value is none of them."""
        return tuple(
            one
            for one in self.fitted(record)
            if not one.optional or values.get(one.name, one.nominal) != one.nominal
        )

    def told_apart(self, values: Values, record: Record) -> float:
        """How many values like these a record tells apart, beyond those of a smooth law; one.

        Where the likelihood of a value is a comb, the highest of its needles is found by chance.
        """
        return 1.0

    def meaning(self, parameter: Parameter, value: float, record: Record) -> str:
        """Say in words what the value of a choice stands for; empty where it is none, or usual."""
        usual = not parameter.meanings or value == parameter.nominal
        return "" if usual else parameter.meanings[value]

    def follows(self, values: Values, record: Record) -> tuple[str, ...]:
        """Names of the auxiliary channels that it follows."""
        return ()

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

    def own_grid(self, record: Record) -> Sequence[OwnValues]:
        """Values to scan that every device has of its own, where one for all says little; none."""
        return ()

    def proposed(
        self, currents: Matrix, pull: Callable[[], Matrix], record: Record
    ) -> Sequence[Values]:
        """Values to scan beside `grid`, from what the record itself says; by default none.

        Args:
            currents: Of all correctors, shape (N, m) [A].
            pull: Tells ∂log L/∂current of every row under the causes so far, shape (N, m) [1/A].
            record: That shows it.
        """
        return ()

    def long_after(self, values: Values) -> Values:
        """Values with which it acts on a record that begins long after it did; the same."""
        return values
