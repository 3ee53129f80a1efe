"""Where the labels of supervised training come from: samples (orbit error, change)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.policies.inverse import regularised_inverse
from orbitfb.policies.training.supervised_settings import SupervisedSettings

Samples = tuple[Vector, Vector]
"""Orbit errors (B, n) [m] and the changes that belong to them (B, m) [A]."""

Source = Callable[[int, torch.Generator], Samples]
"""Gives so many samples; every draw is from the generator, on the CPU and in double precision."""


class Law(Protocol):
    """A law without memory that can be asked about many orbits at once."""

    @property
    def gain_matrix(self) -> Vector:
        """Slope at zero, shape (m, n) [A/m]."""
        ...

    def changes(self, errors: Vector) -> Vector:
        """Give the changes, shape (..., m) [A], for orbit errors, shape (..., n) [m]."""
        ...


@dataclass(frozen=True, slots=True)
class Lesson:
    """What is to be learnt.

    Args:
        training: Samples to train on.
        checking: Samples that are not trained on.
        gain: Slope of the law behind the labels, shape (m, n) [A/m].
    """

    training: Source
    checking: Source
    gain: Vector


def from_states(response: Vector, teacher: Law, settings: SupervisedSettings) -> Lesson:
    """Ask a teacher on random white orbits."""
    bpms = len(response)

    def draw(count: int, generator: torch.Generator) -> Samples:
        errors = _amplitudes(count, settings, generator) * _normal(generator, count, bpms)
        return errors, teacher.changes(errors)

    return Lesson(draw, draw, teacher.gain_matrix)


def from_actions(response: Vector, settings: SupervisedSettings) -> Lesson:
    """Run random changes forward, s = R a; the label −a undoes them."""
    u, sigma, vt = np.linalg.svd(response, full_matrices=False)
    if settings.excitation == "white":
        spread = np.eye(response.shape[1]) * (len(u) ** 0.5 / np.linalg.norm(sigma))
    else:
        spread = (vt.T / sigma) * (len(u) / len(sigma)) ** 0.5

    def draw(count: int, generator: torch.Generator) -> Samples:
        white = _normal(generator, count, spread.shape[1])
        changes = _amplitudes(count, settings, generator) * (white @ spread.T)
        return changes @ response.T, -changes

    return Lesson(draw, draw, regularised_inverse(response, 0.0))


def from_archive(errors: Vector, changes: Vector, settings: SupervisedSettings) -> Lesson:
    """Learn what operation did.

    Args:
        errors: Orbit errors of T ticks in their order, shape (T, n) [m].
        changes: The changes asked for, without dither, shape (T, m) [A].
        settings: Share that is held out.

    Raises:
        EstimationError: There are too few whole rows, or they do not belong together.
    """
    if errors.ndim != 2 or changes.ndim != 2 or len(errors) != len(changes):
        raise EstimationError(
            f"orbit errors of shape {errors.shape} and changes of shape {changes.shape} are no "
            "rows of one archive; give (T, n) and (T, m)"
        )
    whole = np.isfinite(errors).all(axis=1) & np.isfinite(changes).all(axis=1)
    errors, changes = errors[whole], changes[whole]
    kept = len(errors) - max(1, round(settings.held_out * len(errors)))
    if kept < errors.shape[1]:
        raise EstimationError(
            f"{len(errors)} whole rows of operation are too few to learn a law of "
            f"{errors.shape[1]} BPMs from; {settings.held_out:.0%} are held out: record longer"
        )

    def rows(first: int, last: int) -> Source:
        def draw(count: int, generator: torch.Generator) -> Samples:
            chosen = torch.randint(first, last, (count,), generator=generator).numpy()
            return errors[chosen], changes[chosen]

        return draw

    slope = np.linalg.lstsq(errors[:kept], changes[:kept], rcond=None)[0]
    gain = np.asarray(-slope.T, dtype=np.float64)
    return Lesson(rows(0, kept), rows(kept, len(errors)), gain)


def _amplitudes(count: int, settings: SupervisedSettings, generator: torch.Generator) -> Vector:
    """Draw rms of orbits, shape (count, 1) [m]."""
    largest = settings.amplitude
    if settings.smallest_amplitude is None:
        return np.full((count, 1), largest)
    share = torch.rand(count, 1, generator=generator, dtype=torch.float64).numpy()
    return largest * (settings.smallest_amplitude / largest) ** share


def _normal(generator: torch.Generator, *shape: int) -> Vector:
    return torch.randn(*shape, generator=generator, dtype=torch.float64).numpy()
