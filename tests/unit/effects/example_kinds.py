"""Small kinds of effects that stand for real ones."""

import numpy as np

from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.kinds import Parameter
from orbitfb.effects.orbit_kinds import RingKind
from orbitfb.physics.effect import Effect


class _Scaled(Effect):
    def __init__(self, places, factor):
        self._places, self._factor = places, factor

    def actuate(self, setpoints, tick):
        currents = setpoints.copy()
        currents[self._places] *= self._factor
        return currents


class _Ramp(Effect):
    def __init__(self, places, step, rng):
        self._places, self._step, self._rng = places, step, rng

    def sense(self, orbit, tick):
        reading = orbit.copy()
        reading[self._places] += self._step * tick + 1e-9 * self._rng.standard_normal()
        return reading


class ExampleGain(ActuatorKind):
    id = "example-gain"
    stage = "actuator"
    parameters = (
        Parameter("gain", "1", -0.5, 0.5, 0.0, 0.1, "relative error"),
        Parameter("tau", "s", 0.0, 10.0, 0.0, 0.1, "time constant"),
    )
    title = "an example"
    sentence = "The currents are off."
    equation = "θ = (1 + g) u"

    def simulate(self, layout, places, values, rng):
        return _Scaled(places, 1.0 + values["gain"])

    def drive(self, setpoints, values, record):
        return setpoints * (1.0 + values["gain"])


class ExampleRamp(SensorKind):
    id = "example-ramp"
    stage = "sensor"
    parameters = (Parameter("speed", "m/s", -1e-3, 1e-3, 0.0, 1e-6, "speed"),)
    title = "another example"
    sentence = "The readings run away."
    equation = "y = x + v t"
    grows = True

    def simulate(self, layout, places, values, rng):
        return _Ramp(places, values["speed"] * layout.period, rng)

    def restore(self, readings, values, record):
        moved = values["speed"] * record.time[:, None]
        return readings - moved, np.zeros(len(readings))

    def distort(self, orbit, values, record):
        return orbit + values["speed"] * record.time[:, None]


class ExampleRing(RingKind):
    id = "example-ring"
    stage = "optics"
    parameters = (Parameter("shift", "1", -0.1, 0.1, 0.0, 0.01, "tune shift"),)
    title = "a third example"
    sentence = "The tune is off."
    equation = "ν = ν + Δν"

    def simulate(self, layout, places, values, rng):
        return Effect()

    def deflect(self, values, record, currents, orbit):
        return np.zeros_like(orbit)


KINDS = {kind.id: kind for kind in (ExampleGain(), ExampleRamp(), ExampleRing())}
