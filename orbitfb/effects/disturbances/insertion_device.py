"""An insertion device whose gap kicks the beam."""

from collections.abc import Sequence

import numpy as np

from orbitfb.effects.kicks import (
    Moved,
    displacing_names,
    displacing_patterns,
    source_names,
    source_patterns,
    together,
)
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.laws import Law, RandomLaw, Signals
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.gaps import gaps_of
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_PERIODS = (0.015, 0.03, 0.06, 0.2)
_CLOSED = 10e-3
"""Gap at which the kick is told [m]."""


class InsertionDevice(SourceKind):
    """x += G_bq θ g(t), g = 1 when closed."""

    id = "insertion-device"
    stage = "disturbance"
    grows = True
    parameters = (
        Parameter(
            "kick",
            "rad",
            -1e-3,
            1e-3,
            0.0,
            5e-7,
            "Kick of the closed device, at a gap of 10 mm; one end against the other where it "
            "displaces the beam.",
        ),
        Parameter(
            "period",
            "m",
            0.01,
            0.5,
            0.03,
            0.03,
            "Period of the magnets. Used if the record has a gap.",
            log=True,
        ),
        Parameter(
            "duration",
            "s",
            1e-3,
            1e4,
            10.0,
            10.0,
            "Time in which the gap closes. Used if the record has no gap.",
            log=True,
        ),
        Parameter(
            "gap",
            "1",
            0,
            1e3,
            0,
            0,
            "Number of the recorded gap, in the order of their names. Used if there are several.",
            whole=True,
            optional=True,
        ),
    )
    title = "kick by the gap of an insertion device"
    sentence = (
        "When the gap of an insertion device closes, the beam is kicked here. The feed-forward of "
        "the device is wrong or missing. Measure its feed-forward table again."
    )
    equation = (
        "x += G_bq θ g, g = exp(−π (gap − 10 mm) / period) of the recorded gap (K. Halbach, Nucl. "
        "Instrum. Meth. 187 (1981)); in a record without gaps g = min(t / duration, 1) from the "
        "onset on"
    )
    linear = "kick"
    confused_with = ("local-kick", "thermal-drift", "telegraph", "quadrupole-gradient")
    splits = "Record the gap, and open and close it while the feedback holds the orbit."
    collective = False

    def unavailable(self, record: Record) -> str:
        """Without a ring, or where every recorded gap stands still."""
        gaps = gaps_of(record)
        if gaps and not any(map(np.ptp, gaps.values())):
            return "no recorded gap moves"
        return super().unavailable(record)

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """The period where there is a gap, the duration where there is none."""
        kick, period, duration, _ = self.parameters
        return (kick, period if gaps_of(record) else duration)

    def laws(self, signals: Signals) -> Sequence[Law]:
        """By the gap, or a ramp; where no gap is recorded also any smooth course, to and fro."""
        usual = super().laws(signals)
        if gaps_of(signals.record):
            return usual
        layout = signals.record.layout
        to_and_fro = RandomLaw(
            patterns=self.patterns(layout),
            names=self.places_of(layout),
            groups={},
            walk=True,
            together=False,
            rare=False,
            relative=False,
            lag=0,
            size=lambda variance, reading: float(np.sqrt(variance)),
            smooth=True,
        )
        return (*usual, to_and_fro)

    def follows(self, values: Values, record: Record) -> tuple[str, ...]:
        """Its gap, where there is one."""
        names = list(gaps_of(record))
        return (names[int(values.get("gap", 0))],) if names else ()

    def meaning(self, parameter: Parameter, value: float, record: Record) -> str:
        """Name the gap, where there are several."""
        names = list(gaps_of(record))
        if parameter.name != "gap" or len(names) < 2:
            return super().meaning(parameter, value, record)
        return names[int(value)]

    def grid(self, record: Record) -> Sequence[Values]:
        """A kick; every gap that moves, durations where there is none."""
        if gaps := gaps_of(record):
            moving = [number for number, gap in enumerate(gaps.values()) if np.ptp(gap) > 0.0]
            told = {"kick": 5e-7, "duration": 10.0}
            return tuple({**told, "period": p, "gap": k} for k in moving for p in _PERIODS)
        each = (n * record.layout.period for n in (3, 10, 30, 100, 300))
        return tuple(
            {"kick": 5e-7, "period": 0.03, "duration": duration, "gap": 0} for duration in each
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Close once, `duration` long, and stay closed."""

        def course(tick: int) -> float:
            return values["kick"] * min(tick * layout.period / values["duration"], 1.0)

        return Moved(together(self.patterns(layout), places), course)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector and every straight, by plane."""
        return (*source_names(layout), *displacing_names(layout))

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick, or per two of opposite sign at the ends of a straight."""
        return np.hstack([source_patterns(layout), displacing_patterns(layout)])

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """By the gap, or a ramp from the beginning on."""
        gaps = gaps_of(record)
        if not gaps:
            closed = np.minimum(record.time / values["duration"], 1.0)
        else:
            gap = list(gaps.values())[int(values.get("gap", 0))]
            field = np.exp(-np.pi * (gap - _CLOSED) / values["period"])
            closed = field - field[0]
        return values["kick"] * closed[:, None]
