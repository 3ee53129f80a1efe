"""A corrector that is turned about the beam, so that it kicks into the other plane as well."""

import math
from collections.abc import Sequence

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.effects.actuating import PairsEffect
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorRoll(PairKind):
    """The kicks (not the currents) of a corrector in x and y, rotated; or those of one coil.

    A magnet that is turned rotates both. Where the two planes have coils of their own one of them
    may be turned alone: its kick goes into the other plane, and the other one's stays.

    With the calibrations c [rad/A] of the two planes the currents are
    diag(1/c) · rotation · diag(c) · setpoints. Where the ring is not known the two calibrations
    are taken to be equal.
    """

    id = "corrector-roll"
    stage = "actuator"
    target = "corrector"
    title = "roll of a corrector"
    sentence = (
        "The corrector is rotated about the beam axis, so a part of every kick goes into the other "
        "plane. Check its alignment, or put the angle into the model."
    )
    equation = (
        "kick_x = cos φ k_x − sin φ k_y, kick_y = sin φ k_x + cos φ k_y with k = c u; if only one "
        "coil is there, only the terms with its k"
    )
    parameters = (
        Parameter(
            name="angle",
            unit="rad",
            low=-0.8,
            high=0.8,
            nominal=0.0,
            typical=0.05,
            description="Angle of the roll φ, from x to y.",
        ),
    )
    linear = "angle"
    collective = False
    confused_with = ("bpm-roll", "skew-coupling", "corrector-crosstalk")
    splits = (
        "Steps in one plane at a time. A roll kicks into the other plane at this corrector only."
    )

    def unavailable(self, record: Record) -> str:
        """Need a corrector with both planes."""
        both = len(self.pairs(record.layout))
        return "" if both else "needs correctors that are recorded in both planes"

    def pairs(self, layout: Layout) -> Indices:
        """Columns (x, y) of every corrector that has both: both turned, x alone, y alone."""
        return np.tile(_both(layout), (3, 1))

    def struck(self, pairs: Indices) -> Sequence[tuple[int, ...]]:
        """Columns that are turned."""
        both = pairs[: len(pairs) // 3].tolist()
        return [(x, y) for x, y in both] + [(x,) for x, _ in both] + [(y,) for _, y in both]

    def matrix(self, values: Values) -> Matrix:
        """Rotation, where both planes have the same calibration."""
        cosine, sine = math.cos(values["angle"]), math.sin(values["angle"])
        return np.array([[cosine, -sine], [sine, cosine]])

    def matrices(self, layout: Layout, values: Values) -> Matrix:
        """Rotation of the kicks, told for the currents, shape (P, 2, 2)."""
        per_ampere = _calibrations(layout, _both(layout))
        turned = self.matrix(values) * per_ampere[:, None, :] / per_ampere[:, :, None]
        alone = [turned.copy(), turned.copy()]
        for coil, other in ((0, 1), (1, 0)):
            alone[coil][:, :, other] = np.eye(2)[:, other]
        return np.concatenate([turned, *alone])

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Roll the columns that are among the places: both of a corrector, or one alone.

        Raises:
            ConfigError: One of them has no column in the other plane.
        """
        pairs = _both(layout)
        single = np.setdiff1d(places, pairs)
        if len(single):
            names = ", ".join(layout.correctors.label(int(i)) for i in single[:3])
            raise ConfigError(
                f"{self.id}: {names}: a roll needs the corrector in both planes; simulate planes xy"
            )
        pairs = pairs[np.isin(pairs, places).any(axis=1)]
        kick = _calibrations(layout, pairs)
        change = np.empty((len(pairs), 2, 2))
        cosine, sine = math.cos(values["angle"]), math.sin(values["angle"])
        change[:, 0, 0] = change[:, 1, 1] = cosine - 1.0
        change[:, 0, 1] = -sine * kick[:, 1] / kick[:, 0]
        change[:, 1, 0] = sine * kick[:, 0] / kick[:, 1]
        return PairsEffect(pairs, change * np.isin(pairs, places)[:, None, :])


def _both(layout: Layout) -> Indices:
    """Columns (x, y) of every corrector that has both, shape (D, 2)."""
    devices = layout.correctors
    vertical = {devices.names[int(i)]: int(i) for i in devices.in_plane("y")}
    found = [
        (int(i), vertical[devices.names[int(i)]])
        for i in devices.in_plane("x")
        if devices.names[int(i)] in vertical
    ]
    return np.array(found, dtype=np.intp).reshape(-1, 2)


def _calibrations(layout: Layout, pairs: Indices) -> Matrix:
    """Kick per ampere of the columns of pairs (x, y), shape (P, 2) [rad/A]."""
    if layout.ring is None:
        return np.ones(pairs.shape)
    table = layout.ring.table
    place = {name: index for index, name in enumerate(table.name)}
    columns = [place[layout.correctors.names[int(i)]] for i in pairs[:, 0]]
    return table.calibration[:, columns].T
