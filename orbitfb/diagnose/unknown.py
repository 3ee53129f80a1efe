"""What is known of a gap that no effect explains: stage, places, what shows most."""

from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.answer_blocks import Audit, Unknown
from orbitfb.diagnose.answering import place_names
from orbitfb.diagnose.departure import Departure
from orbitfb.diagnose.gof_verdict import COURSES, clearest, stage_of
from orbitfb.diagnose.result.naming import column_names, devices_and_planes
from orbitfb.diagnose.rounds import Round
from orbitfb.diagnose.search import Outcome

_HALF = 0.5


def unknown_of(
    outcome: Outcome, tests: Audit, departures: Sequence[Departure], explained: float
) -> Unknown:
    """Tell it by the tournament, or by a test that says more than any effect.

    Args:
        outcome: Of the search.
        tests: Of what is left.
        departures: Of the winners from their laws, in their order.
        explained: Share of the gain of any model that the causes have.
    """
    first = outcome.rounds[0]
    courses = [its.course for its in departures if its.chance < _HALF]
    stages, places = _stage_shares(first), _places(outcome)
    text = f"What is left goes {courses[0]}." if courses else ""
    said = max((entry.weight for entry in first.entries), default=0.0)
    test = clearest(tests, COURSES)
    if test is None or float(test.nats or 0.0) <= said:
        test = clearest(tests) if said <= 0.0 else None
    if test is not None:  # no effect says as much
        if (stage := stage_of(test)) is not None:
            stages = dict[str, float | None]({stage: 1.0})
        places = tuple(dict.fromkeys((*test.places, *places)))
        text = f"{text} What shows most: {test.name} ({test.note}).".strip()
    return Unknown(
        stages=stages,
        places=places,
        text=text,
        nearest=first.entries[0].kind.id if first.entries else "",
        nearest_nats=first.entries[0].held_out if first.entries else None,
        explained=explained,
    )


def _stage_shares(one: Round) -> dict[str, float | None]:
    """Share every stage has of the best gains of a tournament."""
    best: dict[str, float] = {}
    for entry in one.entries:
        gain = max(entry.weight, 0.0)
        best[entry.kind.stage] = max(best.get(entry.kind.stage, 0.0), gain)
    if not best:
        return {}
    weights = np.array(list(best.values()))
    shares = np.exp(np.clip(weights - weights.max(), -50.0, 0.0))
    shares /= shares.sum()
    return dict(zip(best, shares.tolist(), strict=True))


def _places(outcome: Outcome, most: int = 5) -> tuple[str, ...]:
    """Devices of the nearest effect, if it explains anything; then BPMs that scatter most."""
    bench, layout = outcome.bench, outcome.bench.record.layout
    nearest = tuple[str, ...]()
    for entry in outcome.rounds[0].entries[:1]:
        if entry.weight > 0.0 and len(entry.cause.places) <= most:
            own = place_names(layout, entry.kind, entry.cause.places)
            nearest = devices_and_planes(own)[0]
    counted = ~bench.record.starts
    scatter = np.mean(bench.floor.by_bpm(bench.white[counted]) ** 2, axis=0)
    names = column_names(layout.bpms)
    loudest = (names[int(index)] for index in np.argsort(scatter)[::-1][:most])
    return tuple(dict.fromkeys((*nearest, *loudest)))[:most]
