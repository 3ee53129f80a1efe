"""Several causes together: fitted jointly, void ones dropped, the first ones looked at again."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.budget import Budget
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import price
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit, fit
from orbitfb.diagnose.rounds import Round


def looked_at_again(
    rounds: list[Round],
    moving: tuple[Cause, ...],
    beside: Callable[[tuple[Cause, ...], Sequence[Candidate]], Round],
    budget: Budget,
) -> list[Round]:
    """Let what was found first compete once more, beside what was found after it.

    What a later cause did spoke for or against the laws that the first one was chosen from.

    Args:
        rounds: With their winners.
        moving: Causes of a joint fit.
        beside: Holds a tournament beside some causes.
        budget: Time for it.
    """
    own = [
        index
        for index, one in enumerate(rounds)
        if one.accepted is not None and one.accepted.fit is not None
    ]
    found = list(rounds)
    for index in own[:-1]:
        if budget.over():
            budget.leave("the first cause was not judged again beside the later ones")
            break
        entry = rounds[index].accepted
        if entry is None:
            continue
        others = tuple(cause for cause in moving if not same(cause, entry.cause))
        one = beside(others, [replace(entry.candidate, cause=entry.cause)])
        if one.sure and one.entries[0].fit is not None and one.entries[0].held_out > 0.0:
            found[index] = replace(one, accepted=one.entries[0])
    return found


def same(one: Cause, other: Cause) -> bool:
    """Whether two causes are one, whatever their values."""
    return (one.kind.id, one.places, one.onset) == (other.kind.id, other.places, other.onset)


def without_void(
    nominal: Bench, last: Bench, rounds: Sequence[Round]
) -> tuple[list[Round], Fit | None, tuple[Cause, ...]]:
    """Fit all causes jointly, and drop those that the others have made void.

    What came first may have stood in for what came later: each must be worth its price beside all
    others, which are fitted anew without it.

    Returns:
        The rounds, those of dropped causes without a winner; the joint fit and its causes.
    """
    kept = list(rounds)
    while True:
        own = [
            (index, one.accepted)
            for index, one in enumerate(kept)
            if one.accepted is not None and one.accepted.fit is not None
        ]
        joint, moving = _together(nominal, last, tuple(entry.cause for _, entry in own))
        if joint is None or len(moving) < 2:
            return kept, joint, moving
        base = nominal.with_floor(last.floor)
        worths: list[float] = []
        for place, (_, entry) in enumerate(own):
            rest = fit(base, (*moving[:place], *moving[place + 1 :]))
            occam = 0.0 if entry.fit is None else entry.fit.occam
            lost = (joint.gain - rest.gain) / joint.inflation
            worths.append(lost - occam - price(entry.candidate))
        void = int(np.argmin(worths))
        if worths[void] >= 0.0:
            return kept, joint, moving
        index = own[void][0]
        kept[index] = replace(kept[index], accepted=None)


def _together(
    nominal: Bench, last: Bench, causes: tuple[Cause, ...]
) -> tuple[Fit | None, tuple[Cause, ...]]:
    """Fit all causes jointly under the floor that they leave."""
    if not causes:
        return None, ()
    found = fit(nominal.with_floor(last.floor), causes, precise=True)
    return found, found.causes
