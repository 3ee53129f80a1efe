"""Which of the five states a search ends in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.ambiguity import Group, classes
from orbitfb.diagnose.answer import State
from orbitfb.diagnose.answer_blocks import Audit, Unknown
from orbitfb.diagnose.answer_parts import Shrink
from orbitfb.diagnose.ceiling import Ceiling, ceiling
from orbitfb.diagnose.certain import Certain, Untold
from orbitfb.diagnose.departure import Departure, departure
from orbitfb.diagnose.drift_shape import with_own_shape
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.gof import audit
from orbitfb.diagnose.gof_verdict import COURSES, clearest
from orbitfb.diagnose.rounds import CLOSE, SURE, Round
from orbitfb.diagnose.search import Outcome
from orbitfb.diagnose.unknown import unknown_of
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

_EXPLAINED = 0.8
"""Share of what any model could gain below which a named cause leaves a remainder."""
_SMALL = 0.01
"""Share of the causes' gain below which what a test flags is no part of the gap."""
_STAND_IN = 3.0
"""Scatter of a winner's scores over what its noise model says, beyond which it is none."""
_HALF = 0.5
_STAND_IN_SHRINK = 0.2
"""Share of a resolved gap on held-out data below which the causes only stood in for another."""
_BY_ITSELF = 15.0
"""Weight from which what grows is there, if not in a later record: it may have settled [nats]."""
_NO_TRACE = 1e-6
"""Share below which the causes change nothing there, as what began before and stays does."""


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """How a search ends.

    Args:
        state: Of the five.
        audit: Tests of what is left.
        rest: What a model of any kind could still gain.
        explained: Share of that and of the causes' gain that the causes have.
        groups: Effects that the record cannot split, of the first tournament.
        unknown: What is known of a gap without a name; None when it has one.
        departures: Of the winners from their laws, in their order.
    """

    state: State
    audit: Audit
    rest: Ceiling
    explained: float
    groups: tuple[Group, ...]
    unknown: Unknown | None
    departures: tuple[Departure, ...] = ()


def judge(outcome: Outcome, certain: Certain, seed: int) -> Judgement:
    """Decide whether the causes found are the answer.

    Args:
        outcome: Of the search.
        certain: What the screen has proved.
        seed: Of the bootstrap.
    """
    bench = with_own_shape(outcome.bench)
    tests = audit(bench)
    rest = ceiling(bench, seed)
    named = outcome.given + sum(one.accepted.gain for one in outcome.winners if one.accepted)
    left = max(rest.nats.value, 0.0) if rest.resolved else 0.0
    course = clearest(tests, COURSES)
    left = max(left, 0.0 if course is None else float(course.nats or 0.0))
    explained = named / (named + left) if named + left > 0 else 1.0
    random = any(isinstance(cause.kind, NoiseKind | LatentKind) for cause in outcome.causes)
    test = course if random else clearest(tests)
    flagged = test is not None and float(test.nats or 0.0) >= _SMALL * named
    departures = beside_themselves(
        [
            (
                entry,
                departure(
                    outcome.bench,
                    outcome.final(entry)[0],
                    entry.gain,
                    entry.candidate.whole,
                    one.bench,
                ),
            )
            for one, entry in ((one, one.accepted) for one in outcome.winners)
            if entry is not None
        ]
    )
    remains = (rest.resolved and explained < _EXPLAINED) or flagged
    groups: tuple[Group, ...] = ()
    if outcome.winners:
        groups = classes(outcome.winners[0].entries, outcome.winners[0].bench, CLOSE)
    state = _state(outcome, certain, departures, remains=remains, explained=explained)
    unknown = None
    if state in ("unknown", "named_plus_remainder"):
        unknown = unknown_of(outcome, tests, departures, explained)
    if certain.untold:
        state, unknown = beside_untold(state, unknown, certain.untold)
    return Judgement(state, tests, rest, explained, groups, unknown, departures)


def beside_themselves(found: Sequence[tuple[Entry, Departure]]) -> tuple[Departure, ...]:
    """Take two causes of the very same devices for a law that neither has.

    That two things are wrong with the same few devices is far rarer than one thing that is in no
    library, of which the nearest law leaves a part, and another one takes it. But waves of one
    source are the harmonics of one that is no sine, and what grows there may do so again.

    Args:
        found: Winners and how they depart from their laws, in their order.

    Returns:
        The same, with what the further cause gains for both of them.
    """
    departures = [its for _, its in found]
    for index, (one, _) in enumerate(found):
        for later, (other, _) in enumerate(found[index + 1 :], start=index + 1):
            here = one.cause.places
            alike = one.kind.target == other.kind.target and here == other.cause.places
            if alike and here and not _again(one, other):
                for its, entry in ((index, one), (later, other)):
                    more = Departure("as a second law of the same devices", other.gain, entry.gain)
                    departures[its] = max(departures[its], more, key=lambda own: own.nats)
    return tuple(departures)


def _again(one: Entry, other: Entry) -> bool:
    """Whether one source does by two causes what sources do: has harmonics, or moves again."""
    kind = one.kind
    return kind is other.kind and isinstance(kind, SourceKind) and (kind.periodic or kind.grows)


def held_to_account(judged: Judgement, outcome: Outcome, shrunk: Shrink | None) -> Judgement:
    """Take back a name whose cause does not explain data that it was not found in.

    Args:
        judged: By the record itself.
        outcome: Of the search.
        shrunk: On data used neither for fitting nor for selection; None if there are none.
    """
    named = judged.state in ("named", "ambiguous", "named_plus_remainder")
    if shrunk is None or shrunk.high is None or not named or not too_little(shrunk):
        return judged
    if shrunk.nats is not None and abs(shrunk.nats) < _NO_TRACE:
        return judged
    first = outcome.winners[0].accepted
    grows = first is not None and first.kind.grows and first.weight > _BY_ITSELF
    if shrunk.high < _STAND_IN_SHRINK:
        # What grows does not go on for ever; of which kind and where it is the record has shown.
        state: State = "named_plus_remainder" if grows else "unknown"
    elif judged.state == "named":
        state = "named_plus_remainder"
    else:
        return judged
    unknown = unknown_of(outcome, judged.audit, judged.departures, judged.explained)
    if first is not None and not unknown.text:
        text = (
            f"{first.kind.id} explains the record itself, but not {shrunk.on}: it is mended by "
            "then, or it stands for something else."
        )
        unknown = unknown.model_copy(update={"text": text})
    return replace(judged, state=state, unknown=unknown)


def too_little(shrunk: Shrink) -> bool:
    """Whether causes explain less than half of a gap, on data that they were not found in.

    So do those that make a gap there where none is resolved without them.
    """
    return shrunk.high is not None and shrunk.high < (_HALF if shrunk.resolved else 0.0)


def beside_untold(
    state: State, unknown: Unknown | None, untold: Sequence[Untold]
) -> tuple[State, Unknown | None]:
    """Say that the screen proves more than there is a name for.

    Args:
        state: Of the record without it.
        unknown: What is known of the gap of that record that has no name.
        untold: At least one.
    """
    stages = {its.stage for its in untold}
    told = unknown or Unknown(
        stages=dict.fromkeys(sorted(stages), 1.0 / len(stages)),
        places=tuple(name for its in untold for name in its.devices),
        text=" ".join(its.text for its in untold),
    )
    if state == "ambiguous":
        return state, unknown
    return ("unknown" if state in ("no_gap", "unknown") else "named_plus_remainder"), told


def _state(
    outcome: Outcome,
    certain: Certain,
    departures: Sequence[Departure],
    *,
    remains: bool,
    explained: float,
) -> State:
    # where there may be nothing at all a law that is surely another's is nothing
    if not outcome.winners or (not outcome.winners[0].sure and departures[0].nameless):
        if certain.causes:
            return "named_plus_remainder" if remains else "named"
        return "unknown" if remains or _of_no_kind(outcome.rounds[0]) else "no_gap"
    first = outcome.winners[0]
    law = departures[0]
    if not first.sure:  # there may be nothing at all: no law is wrong yet
        return "unknown" if remains or _of_no_kind(first) else "ambiguous"
    if _stand_in(first) or law.stand_in or law.nameless or explained < _HALF:
        return "named_plus_remainder" if certain.causes else "unknown"
    if remains or any(its.chance < _HALF for its in departures):
        return "named_plus_remainder"
    return "ambiguous" if first.rivals() else "named"


def _stand_in(one: Round) -> bool:
    """Whether the winner only stands for something that is not in the library."""
    fit = None if one.accepted is None else one.accepted.fit
    return fit is not None and fit.inflation > _STAND_IN


def _of_no_kind(one: Round) -> bool:
    """Whether something is surely there of which the library has only stand-ins.

    The evidence against the nominal model counts as it is; that its scores scatter far more than
    they should speaks against the stand-in alone.
    """
    sure = float(np.log(one.kinds) + np.log(SURE / (1.0 - SURE)))
    return any(
        entry.fit is not None
        and entry.fit.inflation > _STAND_IN
        and entry.held_out > 0.0
        and entry.weight + entry.fit.gain - entry.fit.gain / entry.fit.inflation > sure
        for entry in one.entries
    )
