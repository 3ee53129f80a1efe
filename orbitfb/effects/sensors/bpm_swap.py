"""Two BPMs whose readings are exchanged."""

from itertools import combinations

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Values
from orbitfb.effects.sensors.mixing import MixedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmSwap(PairKind):
    """y_i = x_j, y_j = x_i."""

    id = "bpm-swap"
    stage = "sensor"
    target = "bpm"
    parameters = ()
    title = "exchanged readings of two BPMs"
    sentence = (
        "Each of two channels carries the reading of the other. Their cables, or their names in "
        "the database, are exchanged. The feedback may run away."
    )
    equation = "y_i = x_j + v_j, y_j = x_i + v_i"
    collective = False
    confused_with = ("bpm-gain", "bpm-polarity")
    splits = "No experiment is needed. Each of them follows the model of the other."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Exchange two BPMs in each plane that they have, or the planes of one BPM.

        Raises:
            ConfigError: The columns are not those of one or two BPMs.
        """
        bpms = layout.bpms
        by_plane = [
            sorted({int(i) for i in places if bpms.planes[int(i)] == plane}) for plane in ("x", "y")
        ]
        horizontal, vertical = by_plane
        names = {bpms.names[int(i)] for i in places}
        if len(names) == 2 and all(len(columns) in (0, 2) for columns in by_plane):
            pairs = [columns for columns in by_plane if columns]
        elif len(names) == 1 and len(horizontal) == len(vertical) == 1:
            pairs = [[*horizontal, *vertical]]
        else:
            raise ConfigError(
                f"effect {self.id}: {len(names)} BPMs are named; name the two that are exchanged, "
                "names=A+B (or one with both planes, whose planes then are)"
            )
        return MixedReadings(np.array(pairs, dtype=np.intp), self.matrix(values))

    def unavailable(self, record: Record) -> str:
        """Need a pair."""
        inherited = super().unavailable(record)
        return inherited or ("" if len(self.pairs(record.layout)) else "needs two BPMs")

    def pairs(self, layout: Layout) -> Indices:
        """Any two BPMs of a plane, and the two planes of one BPM."""
        bpms = layout.bpms
        found = [pair for plane in layout.planes for pair in combinations(bpms.in_plane(plane), 2)]
        vertical = {bpms.names[int(i)]: i for i in bpms.in_plane("y")}
        found += [
            (i, vertical[bpms.names[int(i)]])
            for i in bpms.in_plane("x")
            if bpms.names[int(i)] in vertical
        ]
        return np.array(found, dtype=np.intp).reshape(-1, 2)

    def matrix(self, values: Values) -> Matrix:
        """Exchange."""
        return np.array([[0.0, 1.0], [1.0, 0.0]])
