"""An insertion device whose gap kicks the beam."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import Moved, source_names, source_patterns, together
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_TRAVEL = 20e-3
"""Way of a gap that makes the whole kick; a scale of its own for other records too [m]."""


class InsertionDevice(SourceKind):
    """x += G_bq θ g(t), g = 1 when closed."""

    id = "insertion-device"
    stage = "disturbance"
    grows = True
    parameters = (
        Parameter(
            "kick", "rad", -1e-3, 1e-3, 0.0, 5e-7, "Kick of the closed device, per 20 mm of a gap."
        ),
        Parameter(
            "duration",
            "s",
            1e-3,
            1e4,
            10.0,
            10.0,
            "Time in which it closes; without effect where the record has its gap.",
            log=True,
            rough=True,
        ),
    )
    title = "kick by the gap of an insertion device"
    sentence = (
        "As the gap of an insertion device closes the beam is kicked here: its feed-forward is "
        "wrong or missing. Measure its table again."
    )
    equation = (
        "x += G_bq θ g, g = (gap at first − gap) / 20 mm by the recorded gap; without one "
        "g = min(t / duration, 1) from the onset on"
    )
    linear = "kick"
    confused_with = ("local-kick", "thermal-drift", "telegraph", "quadrupole-gradient")
    splits = "record the gap, and move it to and fro while the feedback holds"
    collective = False

    def grid(self, record: Record) -> Sequence[Values]:
        """A kick; durations where there is no gap."""
        if gap_of(record) is not None:
            return ({"kick": 5e-7, "duration": 10.0},)
        ticks = (3, 10, 30, 100, 300)
        return tuple({"kick": 5e-7, "duration": n * record.layout.period} for n in ticks)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Close once, `duration` long, and stay closed."""

        def course(tick: int) -> float:
            return values["kick"] * min(tick * layout.period / values["duration"], 1.0)

        return Moved(together(source_patterns(layout), places), course)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """By the gap, or a ramp from the beginning on."""
        gap = gap_of(record)
        if gap is None:
            closed = np.minimum(record.time / values["duration"], 1.0)
        else:
            closed = (gap[0] - gap) / _TRAVEL
        return values["kick"] * closed[:, None]


def gap_of(record: Record) -> Vector | None:
    """The gap that moves most among the channels whose name speaks of a gap; None without one.

    Args:
        record: Whose auxiliary channels are looked at.
    """
    gaps = [
        values
        for name, values in record.auxiliary.items()
        if "gap" in name.lower() and np.all(np.isfinite(values)) and np.ptp(values) > 0
    ]
    return max(gaps, key=lambda values: float(np.ptp(values)), default=None)
