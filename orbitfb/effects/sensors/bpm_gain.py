"""Gain error of a BPM."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import CALIBRATION_ERROR, Parameter, Values
from orbitfb.effects.laws import DeviceLaw, Law, Signals
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmGain(SensorKind):
    """y = (1 + g) (x + v)."""

    id = "bpm-gain"
    stage = "sensor"
    parameters = (Parameter("gain", "1", -0.9, 4.0, 0.0, 0.05, "Relative error of the gain."),)
    title = "gain error of a BPM"
    sentence = (
        "The BPM reads every displacement too large or too small by the same factor. Check its "
        "calibration, its cables and its electronics."
    )
    equation = (
        "y = (1 + g)(x + v): the noise v is scaled, too (J. Safranek, Nucl. Instrum. Meth. A 388 "
        "(1997) 27)"
    )
    linear = "gain"
    delays = 1
    confused_with = (
        "noise-level",
        "bpm-nonlinearity",
        "corrector-gain",
        "bpm-roll",
        "quadrupole-gradient",
    )
    splits = (
        "Orbits at three levels tell it from a nonlinearity. The scale common to all BPMs and all "
        "correctors needs a change of the RF frequency or one calibrated corrector."
    )

    def healthy_scatter(self, layout: Layout) -> Vector:
        """One per cent each."""
        return np.full(len(layout.bpms), CALIBRATION_ERROR)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Scale the readings."""
        scale = 1.0 + values["gain"]
        return ChangedReadings(places, lambda readings: scale * readings)

    def laws(self, signals: Signals) -> Sequence[Law]:
        """What the gain of each BPM makes of the orbit that the correctors drive.

        What else moves the beam, scaled by a gain, is a motion of another size that nobody knows:
        on an orbit that wanders by itself no gain can be told, however it wanders.
        """

        def course(values: Values, given: Signals) -> tuple[Matrix, ...]:
            return (values["gain"] * (given.currents @ given.record.layout.response.T),)

        return [  # what correctors drive at a BPM is in no column of the orbit: none acts alone
            replace(law, course=course, driven=True, some=None)
            for law in super().laws(signals)
            if isinstance(law, DeviceLaw)
        ]

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Scale back."""
        scale = 1.0 + values["gain"]
        jacobian = -readings.shape[1] * math.log(abs(scale))
        return readings / scale, np.full(len(readings), jacobian)

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Scale."""
        return (1.0 + values["gain"]) * orbit
