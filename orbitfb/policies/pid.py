"""The dynamic part of the linear law: integral and derivative of the corrections it asks for.

With u_n = R⁺ e_n, the change that would correct the whole error (all modes have one gain, so
that it does not matter whether the terms are formed in the modes or at the correctors),

    i_n = i_{n−1} + k_I u_n                           integral
    d_n = φ d_{n−1} + (1 − φ) (u_n − u_{n−1})         derivative through a first-order filter
    a_n = −(k_P u_n + i_n + k_D d_n)

φ is `derivative_filter`; 0 leaves the plain difference. The rms of the integral's and of the
derivative's share of a change is limited.

Whoever shortened a change or did not write it hands the old state in again. Then the integral
stands still, and the derivative is later taken over the whole gap: its limit keeps that one
step from becoming a kick. Across a change of the mask no difference is formed, because u is
then solved from other equations.

Source: Åström and Hägglund, PID Controllers: Theory, Design, and Tuning, ch. 3 (derivative
filter, conditional integration), written as a velocity form: the setpoints accumulate a_n.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Vector


class PidSettings(Settings):
    """Gains of the linear law."""

    gain: float = Field(
        default=0.5,
        gt=0.0,
        lt=2.0,
        description="Proportional gain: share of the error per tick [1]; at 2 no loop holds.",
    )
    integral_gain: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Gain of the summed error per tick [1]; 0: no integral.",
    )
    integral_limit: float = Field(
        default=0.01, gt=0.0, description="Largest rms of the integral's share of one change [A]."
    )
    derivative_gain: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Gain of the error's difference between two ticks [1]; 0: no derivative.",
    )
    derivative_filter: float = Field(
        default=0.0,
        ge=0.0,
        lt=1.0,
        description="Share of the last derivative that is kept in the next one [1]; 0: no filter.",
    )
    derivative_limit: float = Field(
        default=0.01,
        gt=0.0,
        description="Largest rms of the derivative's share of one change [A].",
    )

    @property
    def is_memoryless(self) -> bool:
        """Whether the change depends on the present error alone."""
        return self.integral_gain == 0.0 and self.derivative_gain == 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PidState:
    """What integral and derivative carry from tick to tick.

    Args:
        integral: i, shape (m,) [A].
        derivative: d, shape (m,) [A].
        last: u of the last tick, shape (m,) [A]; None before the first.
        mask: Which BPMs it was solved from.
    """

    integral: Vector
    derivative: Vector
    last: Vector | None = None
    mask: bytes = b""


def first_state(correctors: int) -> PidState:
    """Begin without an integral and without a derivative."""
    return PidState(np.zeros(correctors), np.zeros(correctors))


def step(
    settings: PidSettings, correction: Vector, mask: bytes, state: PidState
) -> tuple[Vector, PidState]:
    """Form one change.

    Args:
        settings: Gains.
        correction: u, shape (m,) [A].
        mask: Names the BPMs that it was solved from.
        state: Of the last tick.

    Returns:
        a, shape (m,) [A], and the state of this tick.
    """
    integral = state.integral + settings.integral_gain * correction
    integral = _limited(integral, settings.integral_limit)
    comparable = state.last is not None and state.mask == mask
    difference = correction - state.last if comparable and state.last is not None else 0.0
    kept = settings.derivative_filter
    derivative = kept * state.derivative + (1.0 - kept) * difference
    share = _limited(settings.derivative_gain * derivative, settings.derivative_limit)
    change = -(settings.gain * correction + integral + share)
    return change, PidState(integral, derivative, correction, mask)


def _limited(share: Vector, limit: float) -> Vector:
    rms = float(np.sqrt(np.mean(share**2)))
    return share * (limit / rms) if rms > limit else share
