"""Whether the loop that a policy makes would hold: the growth of the orbit per tick near zero.

A reading is answered at once and the answer is in force at the next tick, so that near zero

    e' = e − R K e,

R the response that the policy was made for and K its slope. The largest |eigenvalue| of
1 − R K is the growth of the orbit per tick: above 1 the loop runs away on the very ring that the
policy was made for. Integral and derivative of the linear law (`policies.pid`) act in the same
eigenvectors; there the growth is that of the 4 by 4 system of error, integral, derivative and
last correction, within the limits of both.

A loop that holds on that response may run away on the ring, whose response is another one. So the
growth is looked at once more on a response that is larger throughout by `MARGIN`: a law that would
run away there is near its limit. A law of gain 2 is exactly on it: the noise of each reading comes
back whole with the other sign, and the orbit grows with the square root of time.

A bound of what must be, no proof of what will be: a law that is not linear may fail far from zero.
"""

from typing import Any

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Vector
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.pid import PidSettings

HIGHEST = 1.0001
"""Growth per tick from which a loop counts as unstable: e-fold in 10,000 ticks. Modes that a law
leaves alone are at 1, but for the rounding of a network's single precision."""

MARGIN = 0.05
"""By how much larger the response of the ring may be than the policy's, a ratio [1].

Errors of 3 % of the calibration of BPMs and of correctors, as on a ring that drifts strongly, make
4.2 %, rounded up."""

UNSTABLE = "unstable"
"""First word of the warning of a policy that must not act."""

_EDGE = 2e-4
"""Larger response on which a loop that is exactly at its limit, of gain 2, passes `HIGHEST` [1]."""


def growth_of(policy: Policy, larger: float = 0.0) -> float:
    """Give the growth per tick on the policy's own response [1]; inf when it has no slope.

    Args:
        policy: One that names its response and its slope at zero, as all do that can be stored.
        larger: By how much the response of the ring is larger than the policy's, a ratio [1].
    """
    answers, settings = _answers(policy)
    return _growth((1.0 + larger) * answers, settings)


def growth_on(policy: Policy, response: Vector, part: tuple[slice, slice] | None = None) -> float:
    """Give the growth per tick on a response that the policy was not made for [1].

    Args:
        policy: One that names its slope at zero.
        response: Of the ring, shape (n, m) [m/A], or of the part.
        part: BPMs and correctors of one plane; None: all.
    """
    outside: Any = policy
    gain = outside.gain_matrix
    if part is not None:
        gain = gain[part[1], part[0]]
    answers = np.linalg.eigvals(response @ gain if len(response) <= len(gain) else gain @ response)
    return _growth(answers, _settings(policy))


def unstable_on(policy: Policy, response: Vector) -> str:
    """Say that a loop would lose the beam on a measured response; "" when it would not.

    Args:
        policy: One that names its slope at zero.
        response: Measured, shape (n, m) [m/A]; what is masked is zero.
    """
    growth = growth_on(policy, response)
    if growth <= HIGHEST:
        return ""
    return (
        f"would lose the beam: on the measured response the orbit grows by "
        f"{growth:.4g} per tick; put a policy in force that is made for that response "
        "(`orbitfb policies list`), or measure again"
    )


def _answers(policy: Policy) -> tuple[Vector, Any]:
    """Give the eigenvalues of R K, shape (k,), complex, and the settings of the law."""
    outside: Any = policy
    response, gain = outside.response, outside.gain_matrix
    if not (np.isfinite(gain).all() and np.isfinite(response).all()):
        return np.array([np.inf]), None
    fewer_bpms = len(response) <= len(gain)
    answers = np.linalg.eigvals(response @ gain if fewer_bpms else gain @ response)
    return answers, _settings(policy)


def _settings(policy: Policy) -> Any:
    """Give the settings of the law inside all masks."""
    while isinstance(policy, MaskedPolicy):
        policy = policy.policy
    inside: Any = policy
    return inside.settings


def _growth(answers: Vector, settings: Any) -> float:
    if isinstance(settings, PidSettings) and not settings.is_memoryless:
        return _dynamic_growth(answers / settings.gain, settings)
    return float(np.max(np.abs(1.0 - answers)))


def _dynamic_growth(answers: Vector, settings: PidSettings) -> float:
    """Give the growth with integral and derivative.

    Args:
        answers: Eigenvalues of R R⁺, shape (k,), complex.
        settings: Gains.
    """
    kept, zero, one = settings.derivative_filter, 0.0 * answers, 1.0 + 0.0 * answers
    integral = np.array([settings.integral_gain * answers, one, zero, zero])
    derivative = np.array(
        [(1.0 - kept) * answers, zero, kept * one, -(1.0 - kept) * one],
    )
    error = np.array([one - settings.gain * answers, zero, zero, zero])
    error = error - integral - settings.derivative_gain * derivative
    last = np.array([answers, zero, zero, zero])
    steps = np.moveaxis(np.array([error, integral, derivative, last]), -1, 0)
    if settings.integral_gain == 0.0:  # what never moves neither grows nor decays
        steps = np.delete(np.delete(steps, 1, axis=1), 1, axis=2)
    return float(np.max(np.abs(np.linalg.eigvals(steps))))


def warning_of(policy: Policy) -> str | None:
    """Say what is wrong with the loop that a policy makes; None when it holds with a margin.

    Args:
        policy: One that names its response and its slope at zero.

    Returns:
        A sentence that begins with `UNSTABLE` when the policy must not act.
    """
    answers, settings = _answers(policy)
    growth = max(_growth(answers, settings), _growth((1.0 + _EDGE) * answers, settings))
    if not growth <= HIGHEST:
        return (
            f"{UNSTABLE}: near zero the orbit would grow by {growth:.4g} per tick on the response "
            "that this policy was made for"
        )
    growth = _growth((1.0 + MARGIN) * answers, settings)
    if not growth <= HIGHEST:
        return (
            f"near its limit: on a response that is larger by {100 * MARGIN:.0f} % the orbit would "
            f"grow by {growth:.4g} per tick; a smaller gain leaves room"
        )
    return None


def is_unstable(warning: str | None) -> bool:
    """Say whether a warning is of a policy that must not act."""
    return warning is not None and warning.startswith(UNSTABLE)
