"""Judge a candidate against the incumbent: a function of both laws and of the model.

The one-step prediction error on the loop's own log is no criterion here: the reading noise sits
in both the orbit and the change that answers it, so that it falls even for a refit that is wrong
by tens of per cent. What counts is the closed loop that is predicted on responses drawn from
the posterior, under the noise and the ground motion that the innovations show, and whether the
rows, before they were used, were likelier under R̂ than under the incumbent's response.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Vector
from orbitfb.learn.forecast import WORST_RMS, Gain, Kicks, Prediction, paired_gain, predict_pairs
from orbitfb.learn.reach import needed_change
from orbitfb.learn.rf_steps import RfSteps, rf_steps
from orbitfb.learn.settings import JudgeSettings
from orbitfb.learn.simulation import BatchPolicy, Outcome, Scene, simulate
from orbitfb.models.linear import LinearModel

_UM = 1e6
_PROBES = 8
_LIKE = 1.05
"""A change is not larger than another one when it is below so many times that."""
_TOLD = 0.1
"""Share of the expected beam motion from which what stays besides is told: added in squares, less
changes it by half a per cent at most [1]."""
_ROUNDING = 1e-6
"""A law whose change differs by more from that of its gain is not linear."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the judge says.

    Args:
        accepted: Whether the candidate may act.
        reason: Why, in one sentence with figures.
        figures: Judged figures by name, SI.
    """

    accepted: bool
    reason: str
    figures: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Evidence:
    """What rows, each before it was used, say of R̂ against the incumbent's response.

    Args:
        nats: Log-likelihood ratio of the rows since the last judgement [nats].
        page: Page's sum of it since the incumbent is in force [nats].
    """

    nats: float
    page: float


def judge(
    candidate: Policy,
    incumbent: Policy,
    model: LinearModel,
    evidence: Evidence,
    settings: JudgeSettings,
    generator: np.random.Generator,
    cost: float = 0.0,
    unreachable: float = 0.0,
    hertz_square: float = 0.0,
) -> Verdict:
    """Compare two laws.

    Two proportional laws a = −K e are compared by the recursion of covariances. If one of them
    is not linear, both are simulated; their gain at zero still tells the growth.

    Args:
        candidate: The law that may act.
        incumbent: The law to beat.
        model: The posterior of R and the noise.
        evidence: What the rows say of R̂ against the incumbent's response.
        settings: Limits and margins.
        generator: For the responses and the noise; both laws see the same ones.
        cost: Least gain that pays for a swap, a ratio [1] (`swap_cost`).
        unreachable: Orbit error that stays under any law, rms [m]; only told.
        hertz_square: Mean square of the RF's step of a tick [Hz²].
    """
    size = len(model.modes)
    ours_gain, theirs_gain = gain_of(candidate, size), gain_of(incumbent, size)
    if not np.isfinite(ours_gain).all():
        return Verdict(False, "the candidate's gain matrix is not finite", {})
    least = cost if settings.margin is None else settings.margin
    at = settings.change_orbit
    linear = is_linear(candidate, ours_gain, at) and is_linear(incumbent, theirs_gain, at)
    must_be_resolved = settings.resolved and evidence.page < settings.evidence
    responses, ours, theirs = predict_pairs(
        ours_gain,
        theirs_gain,
        model,
        settings.horizon,
        islice(model.samples(generator), settings.samples),
        least if linear and must_be_resolved else None,
        _kicks(rf_steps(model.rf, candidate, incumbent, hertz_square), model, generator),
    )
    figures = {"growth_candidate": ours.growth, "growth_incumbent": theirs.growth}
    obstacle = None
    if not linear:
        scene = Scene(
            np.stack(responses),
            model,
            settings.simulated_ticks,
            settings.change_orbit,
            settings.recovery_ticks,
            int(generator.integers(2**32)),
        )
        mine = simulate(_in_batches(candidate, ours_gain), scene)
        others = simulate(_in_batches(incumbent, theirs_gain), scene)
        ours = replace(ours, rms=mine.rms, each=mine.each)
        theirs = replace(theirs, rms=others.rms, each=others.each)
        figures |= {
            "recovery_candidate": mine.left,
            "recovery_incumbent": others.left,
            "peak_candidate": mine.peak,
        }
        obstacle = _recovery(mine, others, settings)
    change = _change_rms(candidate, ours_gain, settings)
    usual = _change_rms(incumbent, theirs_gain, settings)
    figures |= {
        "predicted_rms_candidate": ours.rms,
        "predicted_rms_incumbent": theirs.rms,
        "unreachable_rms": unreachable,
        "evidence": evidence.nats,
        "evidence_page": evidence.page,
        "change_rms": change,
    }
    gain = paired_gain(ours, theirs)
    figures |= {"gain": gain.mean, "responses": float(len(responses))}
    if len(responses) > 1:
        figures |= {"gain_low": gain.low, "gain_high": gain.high}
    if obstacle is not None:
        return Verdict(False, obstacle, figures)
    if not change <= max(settings.change_limit, _LIKE * usual):
        moving = np.abs(ours_gain).max(axis=1) > 0.0
        needed = needed_change(model, moving, settings.change_orbit)
        if not change <= _LIKE * needed:
            reason = (
                f"an orbit error of {settings.change_orbit * _UM:.0f} µm would change the "
                f"setpoints by {change:.3g} A rms (incumbent {usual:.3g} A, to correct it whole "
                f"{needed:.3g} A, limit {settings.change_limit:.3g} A)"
            )
            return Verdict(False, reason, figures)
    accepted, reason = _decide(ours, theirs, gain, evidence, settings, least, unreachable)
    return Verdict(accepted, reason, figures)


def _kicks(
    steps: RfSteps | None, model: LinearModel, generator: np.random.Generator
) -> Kicks | None:
    if steps is None:
        return None
    modes = model.modes
    return lambda response: steps.kicks(
        modes.T @ (response - model.response), response, modes, generator
    )


def is_linear(policy: Policy, gain: Vector, amplitude: float) -> bool:
    """Say whether a policy is its gain matrix, up to an amplitude.

    Args:
        policy: One that cannot decide in batches counts as linear.
        gain: Its gain at zero, shape (m, n) [A/m].
        amplitude: White orbit error at which it is asked, rms [m].
    """
    at_once = _at_once(policy, gain.shape[1])
    if at_once is None:
        return True
    errors = amplitude * np.random.default_rng(0).standard_normal((_PROBES, gain.shape[1]))
    expected = -(errors @ gain.T)
    off = float(np.linalg.norm(at_once.changes(errors) - expected))
    return off <= _ROUNDING * float(np.linalg.norm(expected))


def _at_once(policy: Policy, readings: int) -> BatchPolicy | None:
    """Give a policy that decides in batches; one that has a memory refuses to."""
    if not isinstance(policy, BatchPolicy):
        return None
    try:
        policy.changes(np.zeros((1, readings)))
    except ConfigError:
        return None
    return policy


def _in_batches(policy: Policy, gain: Vector) -> BatchPolicy:
    at_once = _at_once(policy, gain.shape[1])
    return _Proportional(gain) if at_once is None else at_once


@dataclass(frozen=True, slots=True)
class _Proportional:
    gain: Vector

    def changes(self, errors: Vector) -> Vector:
        return -(errors @ self.gain.T)


def _change_rms(policy: Policy, gain: Vector, settings: JudgeSettings) -> float:
    """Give the change that a white orbit error of `change_orbit` makes, rms [A]."""
    if _at_once(policy, gain.shape[1]) is None:
        return settings.change_orbit * float(np.linalg.norm(gain) / np.sqrt(len(gain)))
    draws = np.random.default_rng(0).standard_normal((_PROBES, gain.shape[1]))
    errors = settings.change_orbit * draws
    return float(np.sqrt(np.mean(_in_batches(policy, gain).changes(errors) ** 2)))


def _recovery(ours: Outcome, theirs: Outcome, settings: JudgeSettings) -> str | None:
    """Say why the candidate may not answer a kick; None: it may."""
    kick = f"a kick of {settings.change_orbit * _UM:.0f} µm"
    if ours.peak > settings.highest_peak and ours.peak > theirs.peak:
        return (
            f"after {kick} the orbit would grow to {ours.peak:.3g} times the kick on a response "
            f"that the data allow (incumbent {theirs.peak:.3g}, limit {settings.highest_peak:.3g})"
        )
    if ours.left > settings.slowest_recovery and ours.left > theirs.left:
        return (
            f"{settings.recovery_ticks} ticks after {kick} {ours.left:.3g} of it would be left "
            f"(incumbent {theirs.left:.3g}, limit {settings.slowest_recovery:.3g})"
        )
    return None


def _decide(
    ours: Prediction,
    theirs: Prediction,
    gain: Gain,
    evidence: Evidence,
    settings: JudgeSettings,
    cost: float,
    unreachable: float,
) -> tuple[bool, str]:
    if ours.growth > settings.slowest_growth and ours.growth >= theirs.growth:
        return False, (
            f"on a response that the data allow the orbit would grow by {ours.growth:.4f} per "
            f"tick (incumbent {theirs.growth:.4f}, limit {settings.slowest_growth:.4f})"
        )
    if evidence.nats < -settings.evidence:
        return False, (
            "new data fit the present response better than the candidate's, by "
            f"{-evidence.nats:.1f} nats (limit {settings.evidence:.1f})"
        )
    compared = (
        f"expected beam motion {_in_words(ours.rms)}, with the running policy "
        f"{_in_words(theirs.rms)}"
    )
    if unreachable > _TOLD * ours.rms:
        compared += f" (and {_in_words(unreachable)} that the correctors cannot reach)"
    interval = f"[{100 * gain.low:.2g}, {100 * gain.high:.2g}] % over the responses drawn"
    if not gain.mean >= cost:
        return False, f"{compared}: the gain is below the {100 * cost:.2g} % that a swap costs"
    better = f"{compared}: better by {100 * gain.mean:.1f} %, {interval}"
    refuted = evidence.page >= settings.evidence
    if settings.resolved and not (gain.low >= cost or refuted):
        return False, (
            f"{better}: not resolved, and the rows do not refute the incumbent's response "
            f"({evidence.page:.1f} of {settings.evidence:.1f} nats)"
        )
    told = f"; the rows refute the incumbent's response by {evidence.page:.1f} nats" * refuted
    return True, f"{better}{told}"


def _in_words(rms: float) -> str:
    return "without bound" if rms >= WORST_RMS else f"{rms * _UM:.4f} µm rms"


def gain_of(policy: Policy, readings: int) -> Vector:
    """Gain matrix K of a policy, shape (m, n) [A/m]; asked element by element if it names none.

    Args:
        policy: The policy.
        readings: Number of BPMs n.
    """
    known = getattr(policy, "gain_matrix", None)
    if known is not None:
        return known
    probe = 1e-6
    valid = np.ones(readings, dtype=np.bool_)
    columns = [
        -policy.act(probe * unit, valid, policy.initial_state())[0] / probe
        for unit in np.eye(readings)
    ]
    return np.array(columns).T
