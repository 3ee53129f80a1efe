"""Effects on single elements of the response: a row or a column that is not of this model."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.signals import Mask
from orbitfb.effects.kinds import EffectKind, Parameter, Values
from orbitfb.effects.laws import ElementsLaw, Law, Signals
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record

_LEAST = 3
"""Elements that a device must have: one is a gain, two are a gain and a local phase."""


class ChangedElements(Effect):
    """A response that is another one in some elements.

    Args:
        change: What is added to the response, shape (n, m) [m/A].
    """

    def __init__(self, change: Matrix) -> None:
        self._change = change

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        """Add what the other elements make of the currents."""
        return orbit + self._change @ currents


class ElementsKind(EffectKind):
    """Every element of a device's response is wrong by an amount of its own."""

    stage = "optics"
    parameters = (
        Parameter(
            name="share",
            unit="1",
            low=0.0,
            high=3.0,
            nominal=0.0,
            typical=0.1,
            description="Rms of the errors of the elements, divided by the rms of the elements.",
        ),
    )
    linear = "share"
    elemental = True
    collective = False
    sudden = False

    @abstractmethod
    def table(self, response: Matrix) -> Matrix:
        """A row per device of a matrix of the response's shape, and the other way round."""

    @abstractmethod
    def devices(self, layout: Layout) -> tuple[Devices, Devices]:
        """The devices, and those that they have an element with."""

    def there(self, layout: Layout) -> Mask:
        """Which elements the model has: those of one plane, shape (D, E)."""
        own, others = self.devices(layout)
        return np.asarray(np.array(own.planes)[:, None] == np.array(others.planes))

    def unavailable(self, record: Record) -> str:
        """Need some elements."""
        there = self.there(record.layout)
        few = not there.size or int(there.sum(axis=1).max()) < _LEAST
        return f"needs devices with {_LEAST} elements of the response" if few else ""

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Draw the errors of the elements, with exactly the given rms."""
        model, there = self.table(layout.response), self.there(layout)
        change = np.zeros_like(model)
        for place in places:
            drawn = rng.standard_normal(int(there[place].sum()))
            wanted = values["share"] * float(np.linalg.norm(model[place, there[place]]))
            change[place, there[place]] = drawn * (wanted / float(np.linalg.norm(drawn)))
        return ChangedElements(self.table(change))

    def with_elements(
        self, layout: Layout, places: Indices, elements: Mapping[str, float]
    ) -> Effect:
        """Change the elements that are given, of the devices that are."""
        numbers = {name: number for number, name in enumerate(labels(self.devices(layout)[1]))}
        change = np.zeros_like(self.table(layout.response))
        for name, error in elements.items():
            if name not in numbers:
                raise ConfigError(
                    f"effect {self.id}, elements: there is no {name} in this ring"
                    f"{did_you_mean(name, numbers)}"
                )
            change[places, numbers[name]] = error
        return ChangedElements(self.table(change))

    def laws(self, signals: Signals) -> Sequence[Law]:
        """Free elements of every device."""
        layout = signals.record.layout
        there = self.there(layout)
        own, others = self.devices(layout)
        model = np.where(there, self.table(layout.response), 0.0)
        scale = np.sqrt(np.sum(model**2, axis=1) / np.maximum(there.sum(axis=1), 1))
        return (ElementsLaw(labels(own), labels(others), there, scale, self.target == "bpm"),)


def labels(devices: Devices) -> tuple[str, ...]:
    """Names of all columns, as the diagnosis has them."""
    return tuple(devices.label(column) for column in range(len(devices)))
