"""Judge a candidate against the incumbent: a pure function of both laws and of the model.

The one-step prediction error on the loop's own log is no criterion here: the reading noise sits
in both the orbit and the change that answers it, so that it falls even for a refit that is wrong
by tens of per cent. What counts is the closed loop that is predicted on responses drawn from
the posterior, under the noise and the ground motion that the innovations show, and whether the
rows, before they were used, were likelier under R̂ than under the incumbent's response.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Vector
from orbitfb.learn.settings import JudgeSettings
from orbitfb.models.linear import LinearModel

_WORST_RMS = 1.0
_UM = 1e6


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
    candidate: Vector,
    incumbent: Vector,
    model: LinearModel,
    nats: float,
    settings: JudgeSettings,
    generator: np.random.Generator,
) -> Verdict:
    """Compare two proportional laws a = −K e.

    Args:
        candidate: K of the candidate, shape (m, n) [A/m].
        incumbent: K of the incumbent, shape (m, n) [A/m].
        model: The posterior of R and the noise.
        nats: Log-likelihood of the rows since the last judgement under R̂, each before it was
            used, over that under the incumbent's response.
        settings: Limits and margins.
        generator: For the responses; both laws see the same ones.
    """
    if not np.isfinite(candidate).all():
        return Verdict(False, "the candidate's gain matrix is not finite", {})
    responses = [model.sample(generator) for _ in range(settings.samples)]
    ours = predict_loop(candidate, responses, model, settings.horizon)
    theirs = predict_loop(incumbent, responses, model, settings.horizon)
    change = settings.change_orbit * float(np.linalg.norm(candidate) / np.sqrt(len(candidate)))
    figures = {
        "predicted_rms_candidate": ours.rms,
        "predicted_rms_incumbent": theirs.rms,
        "growth_candidate": ours.growth,
        "growth_incumbent": theirs.growth,
        "evidence": nats,
        "change_rms": change,
    }
    accepted, reason = _decide(ours, theirs, change, nats, settings)
    return Verdict(accepted, reason, figures)


def _decide(
    ours: Prediction, theirs: Prediction, change: float, nats: float, settings: JudgeSettings
) -> tuple[bool, str]:
    if change > settings.change_limit:
        return False, (
            f"an orbit error of {settings.change_orbit * _UM:.0f} µm would change the setpoints "
            f"by {change:.3g} A rms, more than {settings.change_limit:.3g} A"
        )
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
    if ours.rms > theirs.rms * (1.0 - settings.margin):
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
    products.

    Args:
        gain: K, shape (m, n) [A/m].
        responses: Responses to average over, each of shape (n, m) [m/A].
        model: Reading noise, ground motion and creep.
        horizon: Ticks from a perfect orbit.
    """
    size = len(model.modes)
    ground = (model.modes * model.ground_variances) @ model.modes.T
    creep = model.modes @ model.creep
    squares, growth = [], []
    for response in responses:
        answer = response @ gain
        transition = np.eye(size) - answer
        covariance = ground + model.reading_variance * (answer @ answer.T)
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
        growth.append((later / norm) ** (2.0 / ticks) if np.isfinite(later) else np.inf)
        square = float(np.trace(covariance) + mean @ mean) / size
        squares.append(min(square, _WORST_RMS**2) if np.isfinite(square) else _WORST_RMS**2)
    return Prediction(float(np.sqrt(np.mean(squares))), max(growth))


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
