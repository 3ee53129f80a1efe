"""A quick look at the gap of the last ticks: one round of the tournament with a few laws.

It says whether there is a gap, how large it is, and which effect is suspected. It is not a
diagnosis: it finds one cause only, without alternatives, and does not search again with the cause
in the model.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.gap import GapSight
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import scan_free
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.named import probabilities
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.live.quick import memory, quick_workspace
from orbitfb.diagnose.live.rows import cut_at_jumps
from orbitfb.diagnose.result.naming import devices_and_planes
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, PairLaw
from orbitfb.effects.registry import all_effects
from orbitfb.estimation.priors import MISFIT, SURE
from orbitfb.records.record import Record

_NINETY = 1.645
"""Half-width of a 90 % interval, in standard deviations of a normal number."""

_AS_GOOD = 5.0
"""Lead in evidence with which the better of two candidates is named alone [nats]. It grows with
that evidence as in `impact.named.probabilities`, because all models are a little wrong."""

_SAME = 0.1
"""Relative rms difference between the orbits of two laws below which they count as the same [1]:
an operator would do the same for both."""

_FEW_VALUES = 3
"""Laws with at most so many values are tested at every look. Laws with more values are tested only
if the record shows something: an unknown law of one device, or a delay of all devices."""

_OF_THE_MODEL = ("sensor", "actuator", "optics", "timing")
"""Stages that the model describes. Disturbances and noise are not errors of the model: the feedback
is there to correct them."""


def look(record: Record, stamp: float, kinds: Sequence[EffectKind] | None = None) -> GapSight:
    """Look at a record.

    Args:
        record: The last ticks.
        stamp: Time of its last row [s since the epoch].
        kinds: Effects to test, as far as they are quick; None: all effects of the model.

    Raises:
        EstimationError: The record does not move.
    """
    began = time.monotonic()
    able = of_the_model(record) if kinds is None else kinds
    space = quick_workspace(cut_at_jumps(record), able)
    scorer = Scorer.of(space)
    short, long = _parted(able, space)
    found = candidates_of(space, short, lambda _: None)
    unknown = scan_free(scorer)[0]
    if max(unknown.evidence, memory(space), *(one.evidence for one in found[:1])) > SURE:
        found = sorted(
            [*found, *candidates_of(space, long, lambda _: None)], key=lambda one: -one.evidence
        )
    found = [one for one in found if _makes_sense(one)]
    best = _foremost(found)
    if best is None:
        sight = GapSight(stamp, len(record), 0.0, 0.0, 0.0, False)
    else:
        sight = _sight(record, stamp, best, found)
    return replace(sight, duration=time.monotonic() - began)


def _sight(record: Record, stamp: float, best: Candidate, found: Sequence[Candidate]) -> GapSight:
    """Describe the gap by the candidate that explains it best."""
    ticks = len(record)
    chances = probabilities(found)
    alike = {best.kind.id, *(one.kind.id for one in found if _does_the_same(best, one))}
    reach = _NINETY * float(np.sqrt(2.0 * best.evidence))
    names, planes = _places(best)
    return GapSight(
        time=stamp,
        ticks=ticks,
        nats=best.evidence / ticks,
        low=max(best.evidence - reach, 0.0) / ticks,
        high=(best.evidence + reach) / ticks,
        resolved=best.evidence > SURE,
        effect=best.kind.id,
        places=names,
        planes=planes,
        probability=min(sum(chances[name] for name in alike), 1.0),
        since=float(stamp - (record.time[-1] - record.time[best.onset])),
    )


def of_the_model(record: Record) -> list[EffectKind]:
    """List the effects of the model that a record can show."""
    return [
        kind
        for kind in all_effects().values()
        if kind.stage in _OF_THE_MODEL and not kind.unavailable(record)
    ]


def _parted(
    kinds: Sequence[EffectKind], space: Workspace
) -> tuple[list[EffectKind], list[EffectKind]]:
    """Select effects of single devices and pairs: those with few values, and those with many."""
    of_devices = [
        kind
        for kind in kinds
        if all(isinstance(law, DeviceLaw | PairLaw) for law in space.courses.laws(kind))
    ]
    few = [kind for kind in of_devices if len(space.courses.grid(kind)) <= _FEW_VALUES]
    return few, [kind for kind in of_devices if kind not in few]


def _foremost(found: Sequence[Candidate]) -> Candidate | None:
    """Choose the best candidate; of equally good ones about the same devices the simplest.

    If only one corrector reaches a limit of all correctors, the limit is of that one.
    """
    if not found or found[0].evidence <= 0.0:
        return None
    top = found[0].evidence
    near = [
        one
        for one in found
        if (one.places == found[0].places or _does_the_same(found[0], one))
        and one.evidence > top - _AS_GOOD * (1.0 + MISFIT * top)
    ]
    return min(near, key=lambda one: (_needed(one.kind), -one.evidence))


def _needed(kind: EffectKind) -> int:
    """Count the parameters that a law must have."""
    return sum(not parameter.optional for parameter in kind.parameters)


def _does_the_same(best: Candidate, other: Candidate) -> bool:
    """Say whether both candidates change the orbit in the same way."""
    if best.field is None or other.field is None:
        return best is other
    apart = float(np.sum((best.field - other.field) ** 2))
    return apart < _SAME**2 * float(np.sum(best.field**2))


def _makes_sense(one: Candidate) -> bool:
    """Say whether every value is within the bounds of its parameter."""
    return all(
        parameter.low <= one.values.get(parameter.name, parameter.nominal) <= parameter.high
        for parameter in one.kind.parameters
    )


def _places(one: Candidate) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Give the devices of a candidate, and the plane of each; empty for the whole ring."""
    parted = [devices_and_planes([name]) for name in one.names]
    named = [(devices[0], planes) for devices, planes in parted]
    struck = one.kind.target in ("bpm", "corrector")
    return (
        tuple(name for name, _ in named),
        tuple(str(planes) if struck else "" for _, planes in named),
    )
