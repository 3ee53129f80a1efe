"""An unknown law: any course that the past of devices, its square and time make, or odd noise.

The course of a device is a free sum of its own motion now and some rows ago, of what fades slowly
of it, of its powers, of how far it moves whichever way, and of its motion that grows, fades or
swings slowly: a model that knows no law by name. Its sizes have a prior whose width the record
tells. Where it explains more than every law of the library, what the device does is in no library;
where it finds more beside a law that was accepted, the device does something else besides. So it is
with a course that the devices of a cell, or all BPMs or all correctors, have alike, with noise
whose level follows the beam, and with a place that kicks more than the ground does in some band of
frequencies, whatever its course.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.noise.levels import free_level
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.effects.kicks import source_names, source_patterns
from orbitfb.effects.laws import Signals
from orbitfb.estimation.priors import (
    FREE_BANDS,
    FREE_LAGS,
    FREE_MEMORIES,
    FREE_WAVES,
    FREE_WIDTHS,
    VALUE_COST,
)
from orbitfb.estimation.transform import Indices, Matrix, StepTransform
from orbitfb.records.layout import Devices


@dataclass(frozen=True, slots=True)
class FreeCourse:
    """What a free course of devices explains.

    Args:
        target: `bpm`, `corrector`, `noise` for the level of a BPM's noise, `source` for a place
            that kicks, `shared` for noise in common, `varying` for a cause that comes and goes, or
            `spectrum` for a random one that has not the spectrum of its law.
        names: Of the devices that follow it alike; empty: all of them.
        evidence: Log evidence less the choice of devices and width [nats].
        cell: That they are, if several and not all are.
        places: Their numbers; empty: none of them has a course.
        cost: Of that choice [nats].
    """

    target: str
    names: tuple[str, ...]
    evidence: float
    cell: str = ""
    places: tuple[int, ...] = ()
    cost: float = 0.0

    @property
    def of_all(self) -> bool:
        """Whether all devices follow it alike: then several causes may be at work."""
        return not self.names and self.target in ("bpm", "corrector")


def scan_free(scorer: Scorer) -> list[FreeCourse]:
    """Weigh a free course of every device and cell, and of the level of noise, the best first."""
    signals = scorer.space.signals
    layout = signals.record.layout
    found: list[FreeCourse] = []
    for target, devices in (("bpm", layout.bpms), ("corrector", layout.correctors)):
        patterns, motion = _moving(target, signals)
        basis = _basis(motion, scorer.space.transform)
        cells = _cells(devices)
        cost = float(np.log(1 + len(devices) + len(cells))) + VALUE_COST
        for (cell, members), worth in zip(
            [*(("", np.array([place])) for place in range(len(devices))), *cells],
            _worth(scorer, patterns, basis, [members for _, members in cells]),
            strict=True,
        ):
            names, places = tuple(map(devices.label, members)), tuple(map(int, members))
            found.append(FreeCourse(target, names, float(worth) - cost, cell, places, cost))
        # Without dither a loop makes a ground that does not walk look like a law of all devices.
        if not np.any(scorer.space.noise.colour):
            every = FreeCourse(target, (), 0.0, "", tuple(range(len(devices))), cost)
            found.append(exactly(every, scorer)[0])
    alike, apart = free_level(scorer)
    cost = float(np.log(1 + len(apart)))
    found.append(FreeCourse("noise", (), alike - cost))
    found += [
        FreeCourse("noise", (layout.bpms.label(place),), float(worth) - cost)
        for place, worth in enumerate(apart)
    ]
    found += _sources(scorer)
    return sorted(found, key=lambda one: -one.evidence)


def exactly(one: FreeCourse, scorer: Weighed) -> tuple[FreeCourse, Matrix, float]:
    """Weigh the course that some devices have alike beside all healthy errors.

    Args:
        one: Of devices.
        scorer: Of what is left to explain.

    Returns:
        The same with its evidence; the spectrum of what it adds to the readings with its likeliest
        sizes, shape (T, n) [m]; and what its log likelihood is more than its evidence [nats].
    """
    transform, places = scorer.space.transform, list(one.places)
    patterns, motion = _moving(one.target, scorer.space.signals)
    seen = patterns[:, places].T.astype(np.float32)
    basis = _basis(motion[:, places], transform)
    fields = [transform.quick_spectrum(course) @ seen for course in basis]
    pull, information = scorer.evaluate(fields)
    _, sizes, less = evidence_of_sizes(pull[None], information[None])
    field = np.tensordot(sizes[0], np.stack(fields), axes=1)
    cost = one.cost + float(less[0])
    return replace(one, evidence=scorer.likelihood(field) - cost), field, cost


def _moving(target: str, signals: Signals) -> tuple[Matrix, Matrix]:
    """Patterns of BPMs or correctors, shape (n, D) [m], and how they move, shape (N, D)."""
    layout = signals.record.layout
    if target == "bpm":
        return np.eye(len(layout.bpms)), signals.orbit
    return layout.response, signals.currents


def _cells(devices: Devices) -> list[tuple[str, Indices]]:
    """Cells of several devices, and what they have in each plane, with their columns."""
    planes = [devices.in_plane(plane) for plane in dict.fromkeys(devices.planes)]
    found: dict[tuple[int, ...], str] = {}
    for cell, members in devices.groups().items():
        for within in (members, *(np.intersect1d(members, plane) for plane in planes)):
            if 1 < len(within) < len(devices):
                found[tuple(map(int, within))] = cell
    return [(cell, np.array(members)) for members, cell in found.items()]


def _sources(scorer: Scorer) -> list[FreeCourse]:
    """Weigh at every place whether it kicks more in a band of frequencies than the floor expects.

    What a pattern sees has the mean square ρ = 1 there; where it is more, a variance as large is
    likelier by w (ρ − 1 − ln ρ) / 2 of w frequencies.
    """
    layout = scorer.space.signals.record.layout
    patterns = source_patterns(layout).astype(np.float32)
    seen = patterns.T @ scorer.modes
    square = (scorer.pulled.astype(np.float32) @ patterns) ** 2
    square /= np.maximum(scorer.weights @ (seen**2).T, np.finfo(np.float32).tiny)
    summed = np.vstack([np.zeros_like(square[:1]), np.cumsum(square, axis=0, dtype=np.float64)])
    widths = [width for width in FREE_BANDS if width < len(square)]
    best = np.zeros(len(seen))
    for width in widths:
        excess = np.maximum((summed[width:] - summed[:-width]).max(axis=0) / width, 1.0)
        best = np.maximum(best, 0.5 * width * (excess - 1.0 - np.log(excess)))
    cost = float(np.log(max(square.size * len(widths), 1))) + VALUE_COST
    return [
        FreeCourse("source", (name,), float(worth) - cost)
        for name, worth in zip(source_names(layout), best, strict=True)
    ]


def _worth(
    scorer: Scorer, patterns: Matrix, basis: Sequence[Matrix], cells: Sequence[Indices]
) -> Vector:
    """Log evidence of the free course of every device, and of some that are alike.

    Args:
        scorer: Of the workspace.
        patterns: Of the devices, shape (n, D) [m].
        basis: Courses of all devices that a free one is made of, K of shape (N, D).
        cells: Numbers of devices that may be alike, G of them.

    Returns:
        Shape (D + G,).
    """
    transform = scorer.space.transform
    seen = scorer.seen(patterns)
    spectra = np.stack([transform.quick_spectrum(one) for one in basis], axis=2)
    own = np.einsum("fd,fdk->dk", seen.pulled, spectra).astype(np.float64)
    pull = np.concatenate([own, *(own[one].sum(axis=0, keepdims=True) for one in cells)])
    information = np.zeros((len(pull), len(basis), len(basis)))
    for rows, power, precision in zip(scorer.members, seen.own, seen.precision, strict=True):
        part = spectra[rows].transpose(1, 2, 0)
        information[: len(own)] += power[:, None, None] * (part @ part.transpose(0, 2, 1))
        for number, one in enumerate(cells, len(own)):
            weighed = np.tensordot(precision[np.ix_(one, one)], part[one], axes=1)
            information[number] += np.einsum("dkf,dlf->kl", weighed, part[one], optimize=True)
    return evidence_of_sizes(pull, information)[0]


def evidence_of_sizes(pull: Vector, information: Matrix) -> tuple[Vector, Matrix, Vector]:
    """Log evidence of sizes with the best of some widths.

    Args:
        pull: Shape (D, K).
        information: Shape (D, K, K).

    Returns:
        The evidence, shape (D,), the sizes, (D, K), and what their likelihood is more, (D,).
    """
    best, cost = np.full(len(pull), -np.inf), np.zeros(len(pull))
    sizes = np.zeros_like(pull)
    for width in FREE_WIDTHS:
        inner = np.eye(pull.shape[1]) + width**2 * information
        found = width**2 * np.linalg.solve(inner, pull[:, :, None])[:, :, 0]
        wide = 0.5 * np.linalg.slogdet(inner)[1]
        worth = 0.5 * np.einsum("dk,dk->d", pull, found) - wide
        far = 0.5 * np.sum((found / width) ** 2, axis=1)
        better = worth > best
        best, cost = np.where(better, worth, best), np.where(better, wide + far, cost)
        sizes = np.where(better[:, None], found, sizes)
    return best, sizes, cost


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
    courses += [about * about / scale, about**3 / scale**2, np.abs(courses[1])]
    course = np.arange(len(about)) / max(len(about) - 1, 1)
    for half in range(1, FREE_WAVES + 1):
        courses.append(about * np.cos(np.pi * half * course)[:, None])
    return [*courses, *_fading(motion, transform)]
