"""A power supply that knows only multiples of its smallest step."""

from collections.abc import Callable

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, ladder, scales_of_change
from orbitfb.effects.actuators.rounding import common_steps, read_back_steps, single_steps
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_FINEST = (0.3, 0.05, 0.01)
"""Finest steps looked for, in usual changes of a setpoint: the finer, the more pass for one."""

_LOOKED_AT = 24
"""Single correctors whose needles are sought: those that are pulled at and move most."""

_PROPOSED = 5
"""Needles that are looked at, of all correctors together and of single ones."""


class CorrectorQuantisation(ActuatorKind):
    """Currents rounded to the least significant bit of the converter."""

    id = "corrector-quantisation"
    stage = "actuator"
    title = "quantised current of a corrector"
    sentence = (
        "The power supply rounds its setpoint to the steps of its digital-to-analogue converter. "
        "Changes below half a step do nothing, or too much. The orbit looks noisier than it is."
    )
    equation = "θ_n = q · round(u_n / q)"
    parameters = (
        Parameter(
            name="step",
            unit="A",
            low=0.0,
            high=1.0,
            nominal=0.0,
            typical=0.5e-3,
            description="Smallest step q of the current (LSB).",
            log=True,
        ),
    )
    confused_with = ("ground-motion-level", "corrector-deadband", "noise-level")
    splits = (
        "A slow triangular ramp of one corrector over ten steps or more, or the readback of its "
        "current if that is finer than the step."
    )

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Round."""
        step = values["step"]
        return np.round(setpoints / step) * step if step > 0 else setpoints.copy()

    def grid(self, record: Record) -> tuple[Values, ...]:
        """14 steps around the change of the setpoints, and those that readbacks show."""
        scales = np.array(scales_of_change(record))
        steps = np.outer(scales, np.geomspace(0.3, 60.0, 14)).ravel()
        steps = steps[steps <= self.parameters[0].high]
        return ladder("step", {}, [*read_back_steps(record, 4), *steps])

    def told_apart(self, values: Values, record: Record) -> float:
        """Count the needles of all coarser steps: 1/q is told to 1/(2π u) of setpoints with rms u.

        At a frequency 1/q that is off by so much, the first harmonic of the error of rounding
        agrees with the true one by exp(−1/2) still.
        """
        step, rms = values["step"], float(np.sqrt(np.mean(record.setpoints**2)))
        return max(1.0, 2.0 * np.pi * rms / step) if step > 0 else 1.0

    def proposed(
        self, currents: Matrix, pull: Callable[[], Matrix], record: Record
    ) -> tuple[Values, ...]:
        """Find the needles of all correctors together and of single ones.

        Those of a crate show as those of its correctors, one by one.
        """
        steps, pulled = list[float](), pull()
        for scale in scales_of_change(record):
            finest = sorted(_FINEST)[1] * scale
            steps += common_steps(currents, pulled, finest, _PROPOSED)
            moving = np.argsort(-np.sum(pulled**2, axis=0) * np.var(currents, axis=0))[:_LOOKED_AT]
            steps += single_steps(currents[:, moving], pulled[:, moving], finest, _PROPOSED)
        return ladder("step", {}, steps)

    def hints(self, setpoints: Matrix, pull: Matrix, record: Record) -> tuple[Values, ...]:
        """Find the needles that the grid steps over, coarse ones and those below a dither."""
        steps, crates = list[float](), list(record.layout.correctors.groups().values())
        for scale in scales_of_change(record):
            for share in _FINEST:
                steps += common_steps(setpoints, pull, share * scale, 5)
                if len(crates) > 1:
                    steps += common_steps(setpoints, pull, share * scale, 5, crates)
                steps += single_steps(setpoints, pull, share * scale, 5)
        return ladder("step", {}, steps)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Round tick by tick."""
        return _Quantisation(places, values["step"])


class _Quantisation(ColumnsEffect):
    def __init__(self, places: Indices, step: float) -> None:
        super().__init__(places)
        self._step = step

    def follow(self, wanted: Vector) -> Vector:
        if self._step <= 0:
            return wanted
        return self._step * np.rint(wanted / self._step)
