"""What walks: offsets of BPMs, the energy; seen in the slow lines, not tick by tick.

A walk far below the reading noise changes the variance of an innovation by next to nothing, but
stays: the derivative of Whittle's likelihood by its variance has the slow lines of all modes. A
floor that is estimated with the record has a share of it in every mode, but not that the modes walk
together: the likelihoods with and without are compared beside floors of their own.
"""

from copy import copy

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import KEPT, Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_spectra import Spectra
from orbitfb.effects.random_kinds import NoiseKind

_STRIKING = 4.0
"""Standard deviations from which a place is looked at closely."""
_MANY = 8
"""Places of which the others tell how far one may be off."""
_SIZES = np.geomspace(0.125, 8.0, 13)
"""Variances that are tried, in units of what the score says."""


def walking_candidates(bench: Bench, kind: NoiseKind) -> list[Candidate]:
    """Find shapes that walk for themselves, best first.

    Args:
        bench: The record under the causes accepted so far.
        kind: A walk of a shape that the floor's modes have together.
    """
    patterns = kind.patterns(bench.record.layout)
    score, info = Spectra(bench, Cause(kind, (), _sized(kind, 0.0))).walk_scores(patterns)
    if not np.any(info > 0.0):
        return []
    deviations, scatter = score / np.sqrt(np.maximum(info, 1e-300)), 1.0
    looked, names = np.arange(len(score)), kind.places_of(bench.record.layout)
    if len(names) > _MANY:
        # the floor is not quite right either: no place is struck where all scatter as much
        deviations = deviations - np.median(deviations)
        scatter = max(1.0, 1.4826 * float(np.median(np.abs(deviations))))
        looked = np.argsort(deviations)[::-1][:KEPT]
        looked = looked[deviations[looked] > _STRIKING * scatter]
    found: list[Candidate] = []
    for place in looked:
        usual = max(float(score[place] / info[place]), 1.0 / float(np.sqrt(info[place])))
        variance, gain = _closer(bench, kind, int(place), usual)
        gain /= scatter**2
        if gain > 0.0:
            cause = Cause(kind, (int(place),), _sized(kind, variance))
            group = kind.target == "bpm" and np.count_nonzero(patterns[:, place]) > 1
            label = names[place] if group else ""
            found.append(Candidate(cause, gain, float(len(names)), label, gain))
    return sorted(found, key=lambda one: one.gain, reverse=True)


def _closer(bench: Bench, kind: NoiseKind, place: int, usual: float) -> tuple[float, float]:
    """Best variance per tick of one place, and its gain, each beside a floor of its own."""
    known = Spectra(bench, Cause(kind, (place,), _sized(kind, 0.0)))

    def height(variance: float) -> float:
        values, spectra = _sized(kind, variance), copy(known)
        spectra.profile(values)
        return spectra.log_likelihood(values)

    heights = [height(usual * size) for size in _SIZES]
    best = int(np.argmax(heights))
    return usual * float(_SIZES[best]), heights[best] - height(0.0)


def _sized(kind: NoiseKind, variance: float) -> dict[str, float]:
    return {kind.parameters[0].name: kind.size(variance, 1.0)}
