"""BPM that is turned about the beam."""

import math

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.sensors.mixing import MixedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmRoll(PairKind):
    """The readings of x and y are those of axes turned by φ."""

    id = "bpm-roll"
    stage = "sensor"
    target = "bpm"
    parameters = (
        Parameter(
            "angle",
            "rad",
            -0.8,
            0.8,
            0.0,
            0.02,
            "Angle of the roll φ, positive from the x axis to the y axis.",
        ),
    )
    title = "roll of a BPM"
    sentence = (
        "The BPM is rotated about the beam, or its electronics mix the planes. It reads a part of "
        "x as y, and a part of y as x with the opposite sign. Check its alignment."
    )
    equation = (
        "y_x = x cos φ + y sin φ, y_y = −x sin φ + y cos φ "
        "(J. Safranek, Nucl. Instrum. Meth. A 388 (1997) 27)"
    )
    linear = "angle"
    collective = False
    confused_with = ("skew-coupling", "corrector-roll", "bpm-gain")
    splits = "All BPMs see a skew magnet; only one sees this. Excite one plane after the other."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Turn the BPMs to which the columns belong; either plane's column will do.

        Raises:
            ConfigError: A BPM has a column in one plane only.
        """
        there = {int(column): pair for pair in self.pairs(layout) for column in pair}
        missing = [layout.bpms.label(int(i)) for i in places if int(i) not in there]
        if missing:
            raise ConfigError(
                f"effect {self.id}: {', '.join(missing[:3])}: a roll needs the BPM in both "
                "planes; simulate planes xy"
            )
        pairs = np.array(sorted({tuple(map(int, there[int(i)])) for i in places}), dtype=np.intp)
        return MixedReadings(pairs.reshape(-1, 2), self.matrix(values))

    def unavailable(self, record: Record) -> str:
        """Need BPMs with both planes."""
        inherited = super().unavailable(record)
        return inherited or (
            "" if len(self.pairs(record.layout)) else "needs BPMs that are recorded in both planes"
        )

    def pairs(self, layout: Layout) -> Indices:
        """Columns (x, y) of every BPM that has both."""
        bpms = layout.bpms
        vertical = {bpms.names[int(i)]: int(i) for i in bpms.in_plane("y")}
        both = [
            (int(i), vertical[bpms.names[int(i)]])
            for i in bpms.in_plane("x")
            if bpms.names[int(i)] in vertical
        ]
        return np.array(both, dtype=np.intp).reshape(-1, 2)

    def matrix(self, values: Values) -> Matrix:
        """Rotation."""
        cos, sin = math.cos(values["angle"]), math.sin(values["angle"])
        return np.array([[cos, sin], [-sin, cos]])
