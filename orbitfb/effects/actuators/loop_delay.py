"""Setpoints that come into force later than the feedback believes."""

import math
from collections import deque

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ladder
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_LONGEST = 20
_SHORT = (0.001, 0.003, 0.008, 0.02, 0.05, 0.1)
"""Delays of less than a quarter [ticks], each at most three times the one before: a delay of more
than twice the true one is less likely than none."""


class LoopDelay(ActuatorKind):
    """All setpoints late by the same time; parts of a tick are shared between two ticks.

    A part of a tick is interpolated: that is what a reading sees that averages over its period.
    """

    id = "loop-delay"
    stage = "timing"
    target = "ring"
    title = "delay of the whole loop"
    sentence = (
        "All correctors act later than the feedback assumes. Setpoints travel slowly or queue, or "
        "the readings are older than their time stamps. Tell the feedback the delay, lower its "
        "gain, or shorten the delay."
    )
    equation = "θ_n = (1 − f) u_{n−K} + f u_{n−K−1} with k = K + f ticks"
    parameters = (
        Parameter(
            name="ticks",
            unit="1",
            low=0.0,
            high=float(_LONGEST),
            nominal=0.0,
            typical=1.0,
            description="Delay k in periods of the loop. It need not be a whole number.",
        ),
    )
    homogeneous = True  # below a tick
    confused_with = ("bpm-latency", "corrector-lag", "missed-write", "clock-jitter")
    splits = (
        "Late readings and late correctors give the same record. Time stamps tell them apart, or a "
        "disturbance that no corrector made. A lag has a tail, a delay has none."
    )

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Take the setpoints of earlier rows; before a stretch they were those of its first."""
        whole = math.floor(values["ticks"])
        share = values["ticks"] - whole
        rows = np.arange(len(setpoints))
        first = np.maximum.accumulate(np.where(record.starts, rows, 0))
        late = setpoints[np.maximum(rows - whole, first)]
        if share > 0:
            late += share * (setpoints[np.maximum(rows - whole - 1, first)] - late)
        return late

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Quarters up to two ticks, halves up to six, and short delays from 0.1 % of a tick."""
        steps = (*_SHORT, *np.arange(0.25, 2.0, 0.25), *np.arange(2.0, 6.1, 0.5))
        return ladder("ticks", {}, steps)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Keep setpoints back; all of them, or those of the places if there are any."""
        columns = places if len(places) else np.arange(len(layout.correctors), dtype=np.intp)
        return _Delay(columns, values["ticks"])


class _Delay(Effect):
    def __init__(self, columns: Indices, ticks: float) -> None:
        self._columns = columns
        self._share = ticks % 1.0
        self._past: deque[Vector] = deque(maxlen=int(ticks) + 2)

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Give what was wanted before."""
        wanted = setpoints[self._columns]
        while len(self._past) < (self._past.maxlen or 0):
            self._past.append(wanted)
        self._past.append(wanted)
        currents = setpoints.copy()
        older, newer = self._past[0], self._past[1]
        currents[self._columns] = (1.0 - self._share) * newer + self._share * older
        return currents
