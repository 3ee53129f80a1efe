"""Which of the five states a record is in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.result.diagnosis import State
from orbitfb.diagnose.result.parts import Shrink
from orbitfb.diagnose.selection.rounds import Round
from orbitfb.diagnose.verdict.proved import Proved
from orbitfb.estimation.priors import CERTAIN, REMAINDER


@dataclass(frozen=True, slots=True)
class Judged:
    """The state, and what no effect of the library explains.

    Args:
        state: Of the five.
        left: Devices, or cells, whose free course still explains something, the most telling first.
        nats: What the best of them, or the effect that is left, explains [nats].
        rest: What of the library is sure beside the causes and was not accepted; None: nothing.
        explained: Share of the gap that the causes explain, where more than they is at work [1].
        shared: Devices that two of the causes have in common, and no others; empty: there are none.
        improper: A cause of which the record does not show what makes it that one; None: it does.
    """

    state: State
    left: tuple[FreeCourse, ...]
    nats: float
    rest: Candidate | None = None
    explained: float = 1.0
    shared: tuple[str, ...] = ()
    improper: Named | None = None


def judged(causes: Sequence[Named], rounds: Sequence[Round]) -> Judged:
    """Judge what was found, and what is left.

    Args:
        causes: In the order in which they were found.
        rounds: Of the tournament; the last one shows what is left.
    """
    left = rounds[-1].unknown
    nats = left[0].evidence if left else 0.0
    if not causes:
        return Judged("unknown" if left else "no_gap", left, nats)
    first = causes[0]
    told = sum(one.evidence for one in causes)
    named = sum(one.candidates[0].evidence for one in rounds[:-1])
    nameless = rounds[0].nameless(first.evidence, named)
    if nameless is not None:
        share = told / (told + nameless.evidence)
        return Judged("unknown", (nameless,), nameless.evidence, explained=share)
    # Of a weak cause, which is told as such, the values are hardly known that say what it lacks.
    sure = (one for one in causes if one.probability > CERTAIN)
    improper = next((one for one in sure if one.lacks), None)
    if improper is first:
        return Judged("unknown", left, first.evidence, explained=0.0, improper=first)
    if improper is not None:
        known = told - improper.evidence
        state: State = "named_plus_remainder"
        return Judged(state, left, improper.evidence, explained=known / told, improper=improper)
    rest = rounds[-1].left(told) if len(rounds) > 1 else None
    if rest is not None and rest.evidence > max(nats, REMAINDER * told):
        state = "unknown" if rest.evidence > told else "named_plus_remainder"
        return Judged(state, left, rest.evidence, rest, told / (told + rest.evidence))
    if nats > REMAINDER * told:
        return Judged("named_plus_remainder", left, nats, explained=told / (told + nats))
    alone = first.chances[first.kind.id]
    state = "named" if alone > CERTAIN or not first.rivals else "ambiguous"
    return Judged(state, (), 0.0)


def beside_left(verdict: Judged, shrunk: Shrink | None, foretold: bool) -> Judged:
    """Judge anew with what the causes leave of the errors of predictions.

    An effect that is in no library may look like another one in part. No law need find the rest:
    the floor may have it for noise. The quietest rows, or the reference, say that it is none.

    Args:
        verdict: By what was found.
        shrunk: By the causes, on the record itself; None: nothing of them can be foretold.
        foretold: Whether all causes add something that can be; noise is no error that they leave.
    """
    if verdict.state in ("no_gap", "unknown") or shrunk is None or not foretold:
        return verdict
    gone, most = shrunk.nats, shrunk.high
    if gone is None or most is None or most >= 1.0 - REMAINDER:
        return verdict
    return replace(verdict, state="named_plus_remainder", explained=min(verdict.explained, gone))


def beside_each_other(verdict: Judged, struck: Sequence[tuple[frozenset[str], int]]) -> Judged:
    """Judge anew where two effects are named at the very same devices.

    Of all sets of so many devices the second would have struck that of the first by chance; one
    effect that is in no library, and looks like two that are, need not.

    Args:
        verdict: By what was found.
        struck: Names of the devices of every cause, none where they say nothing, and how many there
            are of their kind.
    """
    if verdict.state != "named":
        return verdict
    same = [one for number, one in enumerate(struck) if one[0] and one in struck[:number]]
    if not same:
        return verdict
    names, devices = same[0]
    chance = 1.0 / (1.0 + devices / len(names))
    shared = tuple(sorted(names))
    return replace(verdict, state="named_plus_remainder", explained=chance, shared=shared)


def beside_proved(state: State, proved: Proved) -> State:
    """Tell the state of a record of which the screen proves something besides.

    Args:
        state: Of the record without it.
        proved: Causes, and what is proved and has no name: a gap, whatever the record shows.
    """
    named: dict[State, State] = {"no_gap": "named", "unknown": "named_plus_remainder"}
    nameless: dict[State, State] = {"no_gap": "unknown", "named": "named_plus_remainder"}
    if proved.causes:
        state = named.get(state, state)
    return nameless.get(state, state) if proved.untold else state
