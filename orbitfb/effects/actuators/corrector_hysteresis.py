"""A corrector whose field depends on where its current came from."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import (
    Arithmetic,
    ColumnsEffect,
    followed,
    ladder,
    widest_range,
    widths,
)
from orbitfb.effects.device_kinds import SteppingKind
from orbitfb.effects.kinds import FIRST_STATE, Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_HALF = 0.5
"""Widest play that a fit tries, as a share of the range of the setpoints."""


class CorrectorHysteresis(SteppingKind):
    """Play: the kick is dragged behind the setpoint, in whole or in part.

    What is lost after a reversal (u − play, a stop) grows linearly and then stays at half the
    width, as the first loop of a Bouc–Wen model does; `share` is its slope. Where within the
    play it was before the record began is not known: it is sought with the rest.
    """

    id = "corrector-hysteresis"
    stage = "actuator"
    title = "hysteresis of a corrector"
    sentence = (
        "After every reversal of the setpoint the field of the corrector lags behind until the "
        "setpoint has moved some way. The iron has remanence, or something has play. Cycle the "
        "magnet, or let the feedback reverse less often and in larger steps."
    )
    equation = (
        "p_n = clip(p_{n−1}, u_n ± w/2), θ_n = u_n + s (p_n − u_n): the play operator "
        "(M. A. Krasnosel'skii and A. V. Pokrovskii, Systems with Hysteresis, 1989)"
    )
    parameters = (
        Parameter(
            name="width",
            unit="A",
            low=0.0,
            high=10.0,
            nominal=0.0,
            typical=1e-3,
            description="Width w of the play: how far the setpoint moves before the field turns.",
            log=True,
        ),
        Parameter(
            name="share",
            unit="1",
            low=-1.0,
            high=1.0,
            nominal=0.0,
            typical=1.0,
            description=(
                "Share s of the field that has play. It is negative if the field runs ahead."
            ),
        ),
    )
    linear = "share"
    remembers = True
    confused_with = ("corrector-deadband", "corrector-lag", "corrector-gain", "corrector-slew")
    splits = (
        "Triangular ramps with reversals at three amplitudes. Only the effect of play depends on "
        "the amplitude."
    )

    def drive_each(
        self, setpoints: Matrix, values: Mapping[str, float | Vector], record: Record
    ) -> Matrix:
        """Drag, row by row."""
        half, share = 0.5 * values["width"], values["share"]
        first = half * values.get(FIRST_STATE, 0.0)

        def law(own: Arithmetic, wanted: Any, held: Any) -> Any:
            return own.least(own.most(held, wanted - half), wanted + half)

        own = np.ndim(half) > 0
        return setpoints + share * (
            followed(setpoints, record, law, own, first, lasts=True) - setpoints
        )

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """Within a play that is too wide for its setpoints a field has a gain."""
        reach = np.ptp(setpoints, axis=0)
        dragged = np.maximum(reach - values["width"], 0.0)
        wide = float(dragged.sum()) < (1.0 - _HALF) * float(reach.sum())
        return "the setpoint never crosses the whole play" if wide else ""

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Both, the width up to half the range: within a wider play what is lost is a gain."""
        width, share = self.parameters
        return replace(width, high=_HALF * widest_range(record)), share

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Widths up to half the range, for the whole current."""
        return ladder("width", {"share": 1.0}, widths(record, _HALF * widest_range(record)))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Drag tick by tick."""
        return _Play(places, 0.5 * values["width"], values["share"])


class _Play(ColumnsEffect):
    def __init__(self, places: Indices, half: float, share: float) -> None:
        super().__init__(places)
        self._half, self._share = half, share
        self._play: Vector | None = None

    def follow(self, wanted: Vector) -> Vector:
        before = wanted if self._play is None else self._play
        self._play = np.clip(before, wanted - self._half, wanted + self._half)
        return (1.0 - self._share) * wanted + self._share * self._play
