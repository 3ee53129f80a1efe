"""Other laws at the devices of the best: a scan may have found each elsewhere, or not at all."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.kinds import EffectKind


def other_laws(
    bench: Bench, entries: Sequence[Entry], kinds: Sequence[EffectKind]
) -> list[Candidate]:
    """Propose the laws that the best entry is confused with at its devices.

    Which of a group's devices are struck is found by what each law makes of them; a law that is
    nearly right finds them too, and the right one must be judged by the same devices. And a scan
    takes its score for a parabola, which a law without a size may be far from.

    Args:
        bench: The record under the causes accepted so far.
        entries: That were fitted.
        kinds: Those that the record can show.
    """
    best = max(entries, key=lambda entry: entry.worth, default=None)
    if best is None or best.weight <= 0.0:
        return []
    if not isinstance(best.kind, ActuatorKind | SensorKind) or best.kind.target == "ring":
        return []  # a pair has no devices of its own
    tried = {entry.kind.id for entry in entries if entry.cause.places == best.cause.places}
    found: list[Candidate] = []
    for kind in kinds:
        able = isinstance(kind, ActuatorKind | SensorKind) and kind.target == best.kind.target
        if able and kind.id in best.kind.confused_with and kind.id not in tried:
            found.append(_at(bench, best, kind))
    return found


def _at(bench: Bench, best: Entry, kind: EffectKind) -> Candidate:
    """A law at the devices of an entry, with the values of its grid that explain most."""
    causes = [
        replace(best.cause, kind=kind, values=values, free=False)
        for values in kind.grid(bench.record)
    ]
    heights = [log_likelihood(*bench.roughly((cause,))) for cause in causes]
    top = int(np.argmax(heights))
    gain = heights[top] - bench.log_likelihood
    return replace(best.candidate, cause=causes[top], gain=gain, alone=None)
