"""How far the gap shrinks with the causes: on a later record where that can tell it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.gap import Parts
from orbitfb.diagnose.impact.later import Later, lacking
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.impact.one_step import OneStep, shrink
from orbitfb.diagnose.impact.windows import Windows
from orbitfb.diagnose.result.parts import Finding, Shrink
from orbitfb.diagnose.verdict.proved import beside
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.noise import StepNoise
from orbitfb.records.record import Record

_ITSELF, _LATER = "the record itself", "the later record"


@dataclass(frozen=True, slots=True)
class Records:
    """What is diagnosed, and what helps.

    Args:
        record: In question.
        reference: Of a time without a gap; None: there is none.
        later: A later record; None: there is none.
    """

    record: Record
    reference: Record | None
    later: Record | None


def shrunk_by(
    records: Records,
    kinds: Sequence[EffectKind],
    its: Explained,
    causes: Sequence[Named],
    step: OneStep,
    parts: Parts,
    own: Shrink | None,
    healthy: StepNoise | None,
) -> tuple[Shrink | None, tuple[Finding, ...]]:
    """Tell how far the gap shrinks with the causes, and what could not be told of it.

    Args:
        records: What is diagnosed.
        kinds: That the record can show.
        its: The record with the causes.
        causes: What is named.
        step: Errors of its predictions one row ahead.
        parts: Of its gap.
        own: What `shrunk_here` gave.
        healthy: Floor of the reference record; None: there is none.
    """
    if own is None or records.later is None:
        return own, ()
    later = beside(records.later, records.record)
    missing = lacking(causes, records.record, later)
    if missing:
        text = (
            f"The later record has no channel {', '.join(missing)}, which a cause follows: so the "
            "causes are tested on the record itself."
        )
        return own, (Finding(check="later-channel", severity="warning", text=text),)
    there = Later.of(later, kinds, its, causes)
    notes = tuple(_notes(there.untold))
    if there.explained is None:
        return own, notes
    windows = Windows.of(len(there.explained.space.transform), step.windows.seed)
    found = OneStep.of(there.explained, windows, _quieter(its.noise, healthy))
    field = there.explained.named
    pulled = there.explained.noise.pull(
        there.explained.nominal - 0.5 * field, there.explained.space.transform
    )
    share = parts.rest / max(len(step.nominal), 1) * len(found.nominal)
    return shrink(found, _LATER, float(np.sum(field * pulled)), share), notes


def shrunk_here(its: Explained, step: OneStep, parts: Parts) -> Shrink | None:
    """Tell how far the gap shrinks on the record itself; None: nothing that counts is foretold.

    Args:
        its: The record with the causes.
        step: Errors of its predictions one row ahead.
        parts: Of its gap.
    """
    if not its.counts:
        return None
    return shrink(step, _ITSELF, float(parts.by_cause.sum()), parts.rest)


def _quieter(first: StepNoise, second: StepNoise | None) -> StepNoise:
    """The floor that is lower on the whole."""
    if second is None:
        return first
    return min(first, second, key=lambda one: float(np.trace(one.walk + 2.0 * one.white)))


def _notes(untold: Sequence[str]) -> Iterator[Finding]:
    if untold:
        text = (
            f"What {' and '.join(untold)} does later is not in the records, so on the later "
            "record it counts as unexplained."
        )
        yield Finding(check="later-course", severity="note", text=text)
