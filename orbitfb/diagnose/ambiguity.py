"""Which effects a record cannot tell apart, so that they are reported together, with what would.

Two candidates are one answer when neither is much more likely than the other and either theory
says that they are alike (`CLASSES`, and what the kinds say of themselves) or this record does:
the changes that they make of the white innovations point the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.answer_blocks import AmbiguousSet, Identifiability
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

NATS = 5.0
"""Evidence by which the better of two must lead to be named alone [nats]."""
NESTED = 2.0
"""Within this of the best the simplest is taken [nats]."""
ALIKE = 0.95
"""Cosine of two changes above which they are the same for this record."""


@dataclass(frozen=True, slots=True)
class Declared:
    """Effects that theory says look alike, with why and what splits them.

    Args:
        kinds: Their ids.
        why: In a few words.
        splits: The experiment.
    """

    kinds: frozenset[str]
    why: str
    splits: str


CLASSES = (
    Declared(
        frozenset({"bpm-gain", "corrector-gain"}),
        "only the product of the gains of BPMs and correctors enters the response",
        "a step of the RF frequency, or one corrector that is calibrated by itself",
    ),
    Declared(
        frozenset({"bpm-latency", "loop-delay"}),
        "only the delay of the whole loop enters a record",
        "time stamps, or a disturbance that no corrector made",
    ),
    Declared(
        frozenset({"bpm-nonlinearity", "bpm-gain"}),
        "at one orbit a curved scale has the slope of a gain",
        "three or more levels of the orbit at the BPM, with both signs",
    ),
    Declared(
        frozenset({"sextupole", "quadrupole-gradient"}),
        "at one orbit the feed-down of a sextupole is a gradient",
        "three or more levels of the orbit at the magnet, with both signs",
    ),
    Declared(
        frozenset({"quadrupole-gradient", "optics-drift", "tune-shift", "tune-drift"}),
        "neighbouring gradients make nearly the same pattern",
        "correctors at other phases; the measured tunes; neighbours may stay alike",
    ),
    Declared(
        frozenset({"corrector-quantisation", "ground-motion-level", "noise-level"}),
        "rounding that is small beside the steps looks like diffuse kicks",
        "a slow triangular ramp of one corrector over ten steps or more",
    ),
    Declared(
        frozenset(
            {"corrector-deadband", "corrector-hysteresis", "corrector-slew", "corrector-lag"}
        ),
        "for one amplitude they all hold part of a step back",
        "a ladder of three amplitudes in both directions",
    ),
    Declared(
        frozenset({"corrector-stuck", "corrector-polarity", "corrector-gain"}),
        "they are gain errors of -1, of -2 and of any size",
        "steps of this corrector alone",
    ),
    Declared(
        frozenset({"missed-write", "clock-jitter"}),
        "both mix the setpoints of two ticks",
        "sequence numbers and time stamps",
    ),
    Declared(
        frozenset({"bpm-offset", "local-kick"}),
        "a kick that few BPMs see is like an offset of one",
        "more BPMs, or a photon monitor",
    ),
)
"""Equivalence classes that every record has."""


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Candidates that the record cannot tell apart.

    Args:
        entries: Best first; the simplest of those that are about as good leads.
        why: Why they are alike; empty for one alone.
        splits: What would tell them apart.
    """

    entries: tuple[Entry, ...]
    why: str = ""
    splits: str = ""

    @property
    def leader(self) -> Entry:
        """What is reported for all."""
        return self.entries[0]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Ids of its effects, each once."""
        return tuple(dict.fromkeys(entry.kind.id for entry in self.entries))

    def reported(self) -> AmbiguousSet:
        """Put it in the form of the answer."""
        return AmbiguousSet(effects=self.kinds, why=self.why, splits=self.splits)


def declared(first: EffectKind, second: EffectKind) -> Declared | None:
    """Say why theory takes two effects for alike; None when it does not."""
    for known in CLASSES:
        if {first.id, second.id} <= known.kinds:
            return known
    for one, other in ((first, second), (second, first)):
        if other.id in one.confused_with:
            return Declared(
                frozenset({first.id, second.id}), "a record may confuse them", one.splits
            )
    return None


def cosines(bench: Bench, causes: Sequence[Cause]) -> Matrix:
    """Compare the changes that causes make of the white innovations.

    What the healthy errors of gains and gradients take over is part of the change. Effects
    without a course in time have no change; their cosines are 0.

    Args:
        bench: The record under the causes that are accepted.
        causes: Candidates with their best values.

    Returns:
        Shape (k, k), 1 on the diagonal.
    """
    changes = [_change(bench, cause) for cause in causes]
    length = [float(np.sqrt(max(_dot(c, c), 1e-300))) for c in changes]
    cosine = np.eye(len(causes))
    for row in range(len(causes)):
        for column in range(row):
            value = _dot(changes[row], changes[column]) / (length[row] * length[column])
            cosine[row, column] = cosine[column, row] = value
    return cosine


def classes(
    entries: Sequence[Entry], bench: Bench | None = None, within: float = NATS
) -> tuple[Group, ...]:
    """Put together what the record cannot split.

    Args:
        entries: Of a tournament.
        bench: Of that tournament; None: only what is declared counts.
        within: By how much less evidence an effect is still in the class of a better one [nats].

    Returns:
        Groups, the best first. Places of the same effect are together when they are alike.
    """
    ranked = sorted(entries, key=lambda entry: entry.weight, reverse=True)
    if not ranked:
        return ()
    near = [entry for entry in ranked if ranked[0].weight - entry.weight <= within]
    cosine = cosines(bench, [entry.cause for entry in near]) if bench else np.eye(len(near))
    groups: list[list[int]] = []
    for index, entry in enumerate(near):
        for group in groups:
            if _together(near[group[0]].kind, entry.kind, float(cosine[group[0], index])):
                group.append(index)
                break
        else:
            groups.append([index])
    found = [_group([near[index] for index in group]) for group in groups]
    return (*found, *(Group((entry,)) for entry in ranked[len(near) :]))


def identifiability(bench: Bench, entries: Sequence[Entry], most: int = 8) -> Identifiability:
    """Report the cosines of the best entry of every effect.

    Args:
        bench: Of the tournament.
        entries: Its entries, best first.
        most: How many effects at most.
    """
    best: dict[str, Entry] = {}
    for entry in entries:
        best.setdefault(entry.kind.id, entry)
    chosen = list(best.values())[:most]
    cosine = cosines(bench, [entry.cause for entry in chosen])
    said: list[str] = []
    for row in range(len(chosen)):
        for column in range(row):
            if abs(cosine[row, column]) > ALIKE:
                one, other = chosen[column].kind, chosen[row].kind
                known = declared(one, other)
                told = f"; to tell them apart: {known.splits.rstrip('.')}" if known else ""
                said.append(f"{one.id} and {other.id} change this record alike{told}.")
    return Identifiability(
        effects=tuple(entry.kind.id for entry in chosen),
        cosine=tuple(tuple(float(x) for x in row) for row in cosine),
        degenerate=tuple(said),
    )


def _together(first: EffectKind, second: EffectKind, cosine: float) -> bool:
    if first.id == second.id:
        return cosine > ALIKE
    return cosine > ALIKE or declared(first, second) is not None


def _group(entries: list[Entry]) -> Group:
    """Let the simplest lead among those that are about as good as the best."""
    best = entries[0].weight
    rivals = [entry for entry in entries if best - entry.weight <= NESTED]
    leader = min(rivals, key=lambda entry: entry.size)
    ordered = (leader, *(entry for entry in entries if entry is not leader))
    others = [entry.kind for entry in ordered if entry.kind.id != leader.kind.id]
    if not others:
        alone = len(ordered) == 1
        return Group(ordered, "" if alone else "neighbouring places make the same pattern")
    known = next((k for kind in others if (k := declared(leader.kind, kind))), None)
    if known is None:
        return Group(ordered, "they change this record alike", leader.kind.splits)
    return Group(ordered, known.why, known.splits)


def _change(bench: Bench, cause: Cause) -> tuple[Matrix, Matrix]:
    if isinstance(cause.kind, NoiseKind | LatentKind):
        return np.zeros_like(bench.white), np.zeros_like(bench.sizes)
    white, sizes, _ = bench.residual((cause,))
    return bench.white - white, bench.sizes - sizes


def _dot(one: tuple[Matrix, Matrix], other: tuple[Matrix, Matrix]) -> float:
    return float(np.sum(one[0] * other[0]) + np.sum(one[1] * other[1]))
