"""An unknown law: any course that the past of devices, its square and time make, or odd noise.

The course of a device is a free sum of its own motion now and some rows ago, of its powers, and of
its motion that grows, fades or swings slowly: a model that knows no law by name. Its sizes have a
prior whose width the record tells. Where it explains more than every law of the library, what the
device does is in no library; where it finds more beside a law that was accepted, the device does
something else besides. So it is with a course that all BPMs or all correctors have alike, and with
noise whose level follows the beam.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.noise.levels import free_level
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.estimation.priors import (
    FREE_LAGS,
    FREE_MEMORIES,
    FREE_WAVES,
    FREE_WIDTHS,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix, StepTransform


@dataclass(frozen=True, slots=True)
class FreeCourse:
    """What a free course of a device explains.

    Args:
        target: `bpm`, `corrector`, or `noise` for the level of a BPM's noise.
        place: Its number; −1: all of them alike.
        name: Of the device; empty: all of them alike.
        evidence: Log evidence less the choice of device and width [nats].
    """

    target: str
    place: int
    name: str
    evidence: float

    @property
    def of_all(self) -> bool:
        """Whether all devices follow it alike: then several causes may be at work."""
        return self.place < 0 and self.target != "noise"


def scan_free(scorer: Scorer) -> list[FreeCourse]:
    """Weigh a free course of every device, and of the level of its noise, the best first."""
    signals = scorer.space.signals
    layout = signals.record.layout
    found: list[FreeCourse] = []
    for target, devices, patterns, motion in (
        ("bpm", layout.bpms, np.eye(len(layout.bpms)), signals.orbit),
        ("corrector", layout.correctors, layout.response, signals.currents),
    ):
        worth = _worth(scorer, patterns, motion)
        cost = float(np.log(1 + len(worth))) + VALUE_COST
        found += [
            FreeCourse(target, place, devices.label(place), float(worth[place]) - cost)
            for place in range(len(worth))
        ]
        # Without dither a loop makes a ground that does not walk look like a law of all devices.
        if not np.any(scorer.space.noise.colour):
            found.append(FreeCourse(target, -1, "", _alike(scorer, patterns, motion) - cost))
    alike, apart = free_level(scorer)
    cost = float(np.log(1 + len(apart)))
    found.append(FreeCourse("noise", -1, "", alike - cost))
    found += [
        FreeCourse("noise", place, layout.bpms.label(place), float(worth) - cost)
        for place, worth in enumerate(apart)
    ]
    return sorted(found, key=lambda one: -one.evidence)


def _worth(scorer: Scorer, patterns: Matrix, motion: Matrix) -> Vector:
    """Log evidence of the free course of every device, shape (D,)."""
    transform = scorer.space.transform
    seen = scorer.seen(patterns)
    basis = _basis(motion, transform)
    spectra = np.stack([transform.quick_spectrum(one) for one in basis], axis=2)
    pull = np.einsum("fd,fdk->dk", seen.pulled, spectra).astype(np.float64)
    information = np.zeros((len(pull), len(basis), len(basis)))
    for rows, own in zip(scorer.members, seen.own, strict=True):
        part = spectra[rows].transpose(1, 2, 0)
        information += own[:, None, None] * (part @ part.transpose(0, 2, 1))
    best = np.full(len(pull), -np.inf)
    eye = np.eye(len(basis))
    for width in FREE_WIDTHS:
        inner = eye + width**2 * information
        solved = np.linalg.solve(inner, pull[:, :, None])[:, :, 0]
        gain = 0.5 * width**2 * np.einsum("dk,dk->d", pull, solved)
        best = np.maximum(best, gain - 0.5 * np.linalg.slogdet(inner)[1])
    return best


def _alike(scorer: Scorer, patterns: Matrix, motion: Matrix) -> float:
    """Log evidence of a free course that is the same for all devices.

    As it has so few sizes, it may also remember for long.
    """
    transform = scorer.space.transform
    courses = [*_basis(motion, transform), *_fading(motion, transform)]
    fields = [transform.quick_spectrum(one) @ patterns.T.astype(np.float32) for one in courses]
    pull, information = scorer.evaluate(fields)
    eye = np.eye(len(pull))
    gains = []
    for width in FREE_WIDTHS:
        inner = eye + width**2 * information
        gain = 0.5 * width**2 * float(pull @ np.linalg.solve(inner, pull))
        gains.append(gain - 0.5 * float(np.linalg.slogdet(inner)[1]))
    return max(gains)


def _fading(motion: Matrix, transform: StepTransform) -> Sequence[Matrix]:
    """What devices did before, fading over some rows, each (N, D)."""
    steps = np.zeros_like(motion)
    steps[transform.step_rows()] = transform.steps(motion)
    courses = []
    for rows in FREE_MEMORIES:
        kept, course = np.exp(-1.0 / rows), np.zeros_like(motion)
        for part in transform.stretches:
            course[part] = lfilter([1.0], [1.0, -kept], steps[part], axis=0)
        courses.append(course)
    return courses


def _basis(motion: Matrix, transform: StepTransform) -> Sequence[Matrix]:
    """Courses of all devices that a free one is made of, each (N, D), as large as the motion."""
    about = motion - motion.mean(axis=0)
    scale = np.maximum(np.sqrt(np.mean(about**2, axis=0)), 1e-100)
    courses = [about]
    for lag in range(1, FREE_LAGS + 1):
        late = about.copy()
        for part in transform.stretches:
            late[part] = about[np.maximum(np.arange(part.start, part.stop) - lag, part.start)]
        courses.append(late - courses[0])
    courses += [about * about / scale, about**3 / scale**2]
    course = np.arange(len(about)) / max(len(about) - 1, 1)
    for half in range(1, FREE_WAVES + 1):
        courses.append(about * np.cos(np.pi * half * course)[:, None])
    return courses
