"""Judge a candidate against the incumbent: a function of both laws and of the model.

The one-step prediction error on the loop's own log is no criterion here: the reading noise sits
in both the orbit and the change that answers it, so that it falls even for a refit that is wrong
by tens of per cent. What counts is the closed loop that is predicted on responses drawn from
the posterior, under the noise and the ground motion that the innovations show, and whether the
rows, before they were used, were likelier under R̂ than under the incumbent's response.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Mask, Vector
from orbitfb.learn.settings import JudgeSettings
from orbitfb.learn.simulation import BatchPolicy, Outcome, Scene, simulate
from orbitfb.models.linear import LinearModel
from orbitfb.policies.inverse import regularised_inverse

_WORST_RMS = 1.0
_UM = 1e6
_PROBES = 8
_LIKE = 1.05
"""A change is not larger than another one when it is below so many times that."""
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
class Prediction:
    """The loop that a law would make.

    Args:
        rms: True orbit after the horizon, mean square over the responses drawn, rms [m].
        growth: Largest growth of the orbit per tick on any of them; below 1 it decays.
    """

    rms: float
    growth: float


def judge(
    candidate: Policy,
    incumbent: Policy,
    model: LinearModel,
    nats: float,
    settings: JudgeSettings,
    generator: np.random.Generator,
) -> Verdict:
    """Compare two laws.

    Two proportional laws a = −K e are compared by the recursion of covariances. If one of them
    is not linear, both are simulated; their gain at zero still tells the growth.

    Args:
        candidate: The law that may act.
        incumbent: The law to beat.
        model: The posterior of R and the noise.
        nats: Log-likelihood of the rows since the last judgement under R̂, each before it was
            used, over that under the incumbent's response.
        settings: Limits and margins.
        generator: For the responses and the noise; both laws see the same ones.
    """
    size = len(model.modes)
    ours_gain, theirs_gain = gain_of(candidate, size), gain_of(incumbent, size)
    if not np.isfinite(ours_gain).all():
        return Verdict(False, "the candidate's gain matrix is not finite", {})
    responses = [model.sample(generator) for _ in range(settings.samples)]
    ours = predict_loop(ours_gain, responses, model, settings.horizon)
    theirs = predict_loop(theirs_gain, responses, model, settings.horizon)
    figures = {"growth_candidate": ours.growth, "growth_incumbent": theirs.growth}
    obstacle = None
    at = settings.change_orbit
    if not (is_linear(candidate, ours_gain, at) and is_linear(incumbent, theirs_gain, at)):
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
        ours, theirs = replace(ours, rms=mine.rms), replace(theirs, rms=others.rms)
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
        "evidence": nats,
        "change_rms": change,
    }
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
    accepted, reason = _decide(ours, theirs, nats, settings)
    return Verdict(accepted, reason, figures)


def is_linear(policy: Policy, gain: Vector, amplitude: float) -> bool:
    """Say whether a policy is its gain matrix, up to an amplitude.

    Args:
        policy: One that cannot decide in batches counts as linear.
        gain: Its gain at zero, shape (m, n) [A/m].
        amplitude: White orbit error at which it is asked, rms [m].
    """
    if not isinstance(policy, BatchPolicy):
        return True
    errors = amplitude * np.random.default_rng(0).standard_normal((_PROBES, gain.shape[1]))
    expected = -(errors @ gain.T)
    off = float(np.linalg.norm(policy.changes(errors) - expected))
    return off <= _ROUNDING * float(np.linalg.norm(expected))


def _in_batches(policy: Policy, gain: Vector) -> BatchPolicy:
    return policy if isinstance(policy, BatchPolicy) else _Proportional(gain)


@dataclass(frozen=True, slots=True)
class _Proportional:
    gain: Vector

    def changes(self, errors: Vector) -> Vector:
        return -(errors @ self.gain.T)


def _change_rms(policy: Policy, gain: Vector, settings: JudgeSettings) -> float:
    """Give the change that a white orbit error of `change_orbit` makes, rms [A]."""
    if not isinstance(policy, BatchPolicy):
        return settings.change_orbit * float(np.linalg.norm(gain) / np.sqrt(len(gain)))
    draws = np.random.default_rng(0).standard_normal((_PROBES, gain.shape[1]))
    errors = settings.change_orbit * draws
    return float(np.sqrt(np.mean(_in_batches(policy, gain).changes(errors) ** 2)))


def needed_change(model: LinearModel, moving: Mask, amplitude: float) -> float:
    """Give the change that corrects a white orbit error whole, by R̂ as far as it is known.

    It is that of the cautious inverse (`policies.inverse`), without regularisation: a gain that
    asks for more overshoots, or trusts what the data do not show.

    Args:
        model: The posterior of R.
        moving: Correctors that may move, shape (m,).
        amplitude: Of the orbit error, rms [m].

    Returns:
        Rms over all m correctors [A].
    """
    if not moving.any():
        return 0.0
    doubt = model.row_covariance[np.ix_(moving, moving)]
    inverse = regularised_inverse(model.response[:, moving], 0.0, doubt)
    return amplitude * float(np.linalg.norm(inverse) / np.sqrt(len(moving)))


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
    ours: Prediction, theirs: Prediction, nats: float, settings: JudgeSettings
) -> tuple[bool, str]:
    if ours.growth > settings.slowest_growth and ours.growth >= theirs.growth:
        return False, (
            f"on a response that the data allow the orbit would grow by {ours.growth:.4f} per "
            f"tick (incumbent {theirs.growth:.4f}, limit {settings.slowest_growth:.4f})"
        )
    if nats < -settings.evidence:
        return False, (
            f"rows that were not used yet speak for the incumbent's response by {-nats:.1f} nats "
            f"(limit {settings.evidence:.1f})"
        )
    compared = (
        f"predicted true orbit {_in_words(ours.rms)} against {_in_words(theirs.rms)} of the "
        "incumbent"
    )
    if not ours.rms <= theirs.rms * (1.0 - settings.margin):
        return False, f"{compared}: not better by {100 * settings.margin:.1f} %"
    return True, f"{compared}: better by {100 * (1 - ours.rms / theirs.rms):.1f} %"


def _in_words(rms: float) -> str:
    return "without bound" if rms >= _WORST_RMS else f"{rms * _UM:.4f} µm rms"


def predict_loop(
    gain: Vector, responses: list[Vector], model: LinearModel, horizon: int
) -> Prediction:
    """Predict the true orbit under a law by doubling the covariance recursion.

    x' = (I − R K) x − R K v + w + b, b the creep: mean and covariance after 2k ticks follow from
    those after k, so that `horizon` ticks (rounded up to a power of two) cost log2(horizon)
    products. They are made in single precision: what that loses is far below any margin, and both
    laws lose it alike.

    Args:
        gain: K, shape (m, n) [A/m].
        responses: Responses to average over, each of shape (n, m) [m/A].
        model: Reading noise, ground motion and creep.
        horizon: Ticks from a perfect orbit.
    """
    size = len(model.modes)
    unit = np.sqrt(model.reading_variance)  # far from the smallest numbers of single precision
    ground = (model.modes * (model.ground_variances / unit**2)) @ model.modes.T
    creep = (model.modes @ (model.creep / unit)).astype(np.float32)
    squares, growth = [], []
    for response in responses:
        answer = response @ gain
        transition = (np.eye(size) - answer).astype(np.float32)
        covariance = (ground + answer @ answer.T).astype(np.float32)
        mean = creep
        norm = 0.0
        ticks = 1
        with np.errstate(over="ignore", invalid="ignore"):
            while ticks < horizon:
                covariance = covariance + transition @ covariance @ transition.T
                mean = mean + transition @ mean
                norm = float(np.linalg.norm(transition))
                transition = transition @ transition
                ticks *= 2
            later = float(np.linalg.norm(transition))
            square = float(np.trace(covariance) + mean @ mean) / size * unit**2
        growth.append(_growth(norm, later, ticks))
        squares.append(min(square, _WORST_RMS**2) if np.isfinite(square) else _WORST_RMS**2)
    return Prediction(float(np.sqrt(np.mean(squares))), max(growth))


def _growth(earlier: float, later: float, ticks: int) -> float:
    """Give the growth per tick from the transition over half the ticks to that over all."""
    if not np.isfinite(later):
        return float("inf")
    return (later / earlier) ** (2.0 / ticks) if earlier > 0.0 else 0.0


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
