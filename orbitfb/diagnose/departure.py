"""Whether causes act as their laws say: what another law of the same devices could gain.

The nearest effect of the library takes over most of what an unknown effect of the same device
does; what is left of it is too little for a test over all devices and lags, but not for one at
the places of the cause: does what is left go with another course there (a change of the setpoint
a tick later, its square, every other tick, growing with time …)? Each course is tried by itself,
and pays for the choice.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import SEEN, Bench
from orbitfb.diagnose.courses import is_wave, own_columns, trials
from orbitfb.diagnose.explain import Cause, explain, restored
from orbitfb.diagnose.latent_laws import latent_laws
from orbitfb.diagnose.noise_departure import noise_laws
from orbitfb.diagnose.noise_follows import follows
from orbitfb.diagnose.other_orbit import other_orbit
from orbitfb.diagnose.problem import Problem
from orbitfb.diagnose.rhythm import rhythm
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

IDEAL = 0.02
"""Share of an effect's gain that nature's departure from a law of the library is worth, if any."""
AWRY = 0.1
"""Share of the effects of the library that depart from their law at all, as far as is seen. It and
the other shares are assumptions, taken from some forty names in records of three generators."""
STAND_IN = 0.5
"""Share of the gain beyond which the law is not that of the effect at all."""
OUTSIDE = 0.15
"""Share of the causes of gaps that are in no library, before the data: one in seven."""
UNTOLD = 0.5
"""Share of these that none of the courses here tells from the library's nearest."""
TOLD = 0.1
"""Share of the nearest effect's gain that a course is worth that tells them from it."""
_NO_NAME = 0.1
"""Chance of a law below which its name is none."""
_OCCAM = 2.0
"""What the size of a course costs [nats]."""
_COST = 5.0
"""What a course has to gain to be seen at all: its size, and the choice among all [nats]."""
_PARTS = (5, 20, 80)
"""Rows of the parts of a record in which a cause may have a strength of its own."""
_STRENGTHS = np.array([0.1, 0.3, 1.0])
"""Scatter of it, over the fitted one."""
_COLOURS = (1, 2)
"""Ticks over which noise that is not quite as the floor says echoes at a BPM."""
_ROUGHLY = 0.1
"""Share of what healthy errors leave that they may miss while the best course is looked for."""
_DISTINCT = 1e-3
"""Part of the information on free changes below which they are alike."""
_ITSELF = 1e-6
"""Part of a change below which the law makes it by itself."""


@dataclass(frozen=True, slots=True)
class Departure:
    """The course that a cause's law lacks most.

    Args:
        course: In words; empty where there is none.
        nats: What it gains, less the price of the choice; at least 0 [nats].
        gain: Of the cause itself [nats].
        excused: Share of that which nature's departures from a law that is right are worth.
    """

    course: str
    nats: float
    gain: float
    excused: float = IDEAL

    @property
    def chance(self) -> float:
        """Probability that the law is the cause's own, given that it is the best of the library.

        Bayes' rule: of laws that are right few are departed from, by exponentially distributed
        shares of the gain; of the nearest laws to what is in no library, those that are told.
        """
        gain = max(self.gain, 0.0)
        missed = min(1.0, UNTOLD + _COST / gain) if gain > 0.0 else 1.0
        if self.nats <= 0.0:
            right, other = 1.0 - AWRY, missed
        else:
            right = AWRY * _density(self.nats, self.excused * gain)
            # where little is seen nobody can tell: no fewer than of the laws that are right
            other = max(1.0 - missed, AWRY) * _density(self.nats, TOLD * gain)
        right, other = (1.0 - OUTSIDE) * right, OUTSIDE * other
        return right / (right + other) if right > 0.0 else 0.0

    @property
    def nameless(self) -> bool:
        """Whether the law is so unlikely that the cause has no name."""
        return self.chance < _NO_NAME

    @property
    def stand_in(self) -> bool:
        """Whether the cause only stands for another effect of the same devices."""
        return self.nats > STAND_IN * self.gain


def _density(nats: float, mean: float) -> float:
    """Of an exponential distribution, of at least the nat that noise makes [1/nat]."""
    return float(np.exp(-nats / (mean + 1.0)) / (mean + 1.0))


def departure(
    bench: Bench, cause: Cause, gain: float, whole: float | None = None, before: Bench | None = None
) -> Departure:
    """Look for a course of a cause's devices that its law does not have.

    Args:
        bench: The record under all causes.
        cause: One of them.
        gain: Of the cause [nats].
        whole: The same with what healthy noise may explain of it [nats]; None: all is the cause's.
        before: The record under the causes before it, for one whose strikes were taken out; None
            where there were none.

    Returns:
        The best course; one that gains nothing where the law leaves nothing.
    """
    if isinstance(cause.kind, LatentKind | NoiseKind):
        if (clock := 0.0 if before is None else rhythm(before, cause)) > 0.0:
            return Departure("by a clock, always after as many ticks", clock, gain, 0.0)
        course, nats = follows(bench, cause)
        if nats > 0.0:  # noise does not, not even now and then
            return Departure(course, nats, gain, 0.0)
        laws = (
            *noise_laws(bench, cause, gain if whole is None else whole),
            *latent_laws(bench if before is None else before, cause),
        )
        course, nats = max(laws, key=lambda law: law[1], default=("", 0.0))
        if nats <= 0.0:
            return Departure("", 0.0, gain)
        # what is normal, or of one sign, has no further law of nature's
        normal = isinstance(cause.kind, LatentKind) and cause.kind.strength == "normal"
        return Departure(course, nats, gain, 0.0 if normal else IDEAL)
    beside = _Beside.of(bench, cause)
    best, top, tried = "", 0.0, 0
    highest = np.zeros_like(bench.white)
    for name, trial in trials(bench, cause):
        height = beside.gain(trial, _ROUGHLY)
        tried += 1
        if height > top:
            best, top, highest = name, height, trial
    nats = beside.gain(highest) - float(np.log(tried)) - _OCCAM
    uneven = _uneven(bench, cause)
    if uneven > max(nats, 0.0):
        best, nats = "with a strength that comes and goes", uneven
    elsewhere = other_orbit(bench, cause) - float(np.log(tried + 1))
    if elsewhere > max(nats, 0.0):
        best, nats = "with its course, as another orbit", elsewhere
    return Departure(best, nats, gain) if nats > 0.0 else Departure("", 0.0, gain)


def _uneven(bench: Bench, cause: Cause) -> float:
    """What a strength of a cause that is drawn anew for every part of a record gains [nats].

    The likelihood ratio of a part whose strength is normal about the fitted one. What a BPM does
    to its noise goes with the noise itself: of BPMs it tells nothing.
    """
    if isinstance(cause.kind, SensorKind) or cause.kind.target == "bpm":
        return 0.0
    others = [one for one in bench.causes if one is not cause]
    without = Bench(bench.record, others, bench.floor, bench.floor.modes)
    change = without.residual(())[0] - without.residual((cause,))[0]
    score, info = np.sum(change * bench.white, axis=1), np.sum(change**2, axis=1)
    heights: list[float] = []
    for rows in _PARTS[-1:] if is_wave(cause) else _PARTS:  # in the short ones are its harmonics
        begins = np.arange(0, len(score), rows)
        pull, known = np.add.reduceat(score, begins), np.add.reduceat(info, begins)
        for variance in _STRENGTHS**2:
            spread = 1.0 + variance * known
            heights.append(float(np.sum(variance * pull**2 / spread - np.log(spread))))
    return 0.5 * max(heights) - float(np.log(len(heights))) - _OCCAM


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """What is left of a record, and what a law does about it without departing from itself.

    Args:
        bench: The record under all causes.
        left: White innovations, sizes of healthy errors, and nothing by row, shape (K,).
        free: Changes of its values and of what it is not to be judged by, shape (F, K).
        pulls: Derivatives of the log-likelihood by them, shape (F,).
    """

    bench: Bench
    left: Vector
    free: Matrix
    pulls: Vector

    @classmethod
    def of(cls, bench: Bench, cause: Cause) -> "_Beside":
        """Take values of a cause as free, and at its BPMs the level of their noise and its echoes.

        Noise is not quite as the floor says.
        """
        record, problem = bench.record, Problem(bench, (cause,))
        others = [one for one in bench.causes if one is not cause]
        base = explain(record, (*others, cause), bench.orbit)
        left = np.concatenate([bench.white.ravel(), bench.sizes, np.zeros(len(record))])
        free, pulls = list[Vector](), list[float]()
        for index in problem.smooth:
            there = problem.start.copy()
            there[index] += problem.nudge(there, index)
            its = explain(record, (*others, *problem.at(there)), bench.orbit)
            scale = its.log_jacobian - base.log_jacobian
            free.append(_seen(bench, base.left - its.left, scale / np.sqrt(len(cause.places) or 1)))
            pulls.append(float(free[-1] @ left + np.sum(scale)))
        if isinstance(cause.kind, SensorKind) or cause.kind.target == "bpm":
            columns = own_columns(bench, cause, bench.white.shape[1])
            noise = restored(record, bench.causes)[0] - bench.orbit
            for late in (0, *_COLOURS):
                echo = np.zeros_like(noise)
                echo[late:, columns] = noise[: len(noise) - late, columns]
                scale = np.full(len(record), 0.0 if late else -float(len(columns)))
                free.append(_seen(bench, echo, scale / np.sqrt(len(columns))))
                pulls.append(float(free[-1] @ left + np.sum(scale)))
        sizes = np.array([np.linalg.norm(its) or 1.0 for its in free])
        matrix = np.array(free).reshape(len(free), len(left)) / sizes[:, None]
        return cls(bench, left, matrix, np.array(pulls) / sizes)

    def gain(self, change: Matrix, missed: float = SEEN) -> float:
        """Gain of a change of best size, the free ones at their best [nats].

        Args:
            change: Shape (N, n) [m].
            missed: Share of what healthy errors leave of it that they may miss to take.
        """
        seen = _seen(self.bench, change, missed=missed)
        shared = self.free @ seen
        taken = np.linalg.pinv(self.free @ self.free.T, rcond=_DISTINCT, hermitian=True) @ shared
        own = float(seen @ seen - shared @ taken)
        if own <= _ITSELF * float(seen @ seen):
            return 0.0
        return 0.5 * float(seen @ self.left - self.pulls @ taken) ** 2 / own


def _seen(
    bench: Bench, change: Matrix, scale: Vector | None = None, missed: float = SEEN
) -> Vector:
    """A change as the record sees it beside healthy errors, shape (K,).

    Args:
        bench: The record.
        change: Of the prediction or the readings, shape (N, n) [m].
        scale: What it does to the log-Jacobian of every row, shape (N,).
        missed: Share of what they leave that they may miss to take.
    """
    rows = np.zeros(len(change)) if scale is None else scale
    return np.concatenate([*map(np.ravel, bench.unhealed(change, missed)), rows])
