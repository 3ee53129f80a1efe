"""Readings that were not read, drawn anew once more of the record is explained."""

from dataclasses import replace

from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.screen.missing import drawn
from orbitfb.estimation.priors import DRAWN_AGAIN


def misses(space: Workspace) -> bool:
    """Whether so much was not read that it matters how it is drawn."""
    return bool(space.signals.record.filled.mean() >= DRAWN_AGAIN)


def redrawn(space: Workspace, by: Workspace | None = None) -> Workspace:
    """Draw what was not read with all that is known now: healthy errors, and accepted causes.

    A draw that knows less says that they were not there at these rows. Records that miss next to
    nothing are left as they are.

    Args:
        space: Whose readings are drawn.
        by: What knows more of the same record; None: the same.
    """
    if not misses(space):
        return space
    its = space if by is None else by
    made = its.explained + its.terms.contribution(its.priors.mean(its.errors.pull))
    fresh = drawn(space.signals.record, space.transform.summed(made))
    signals = replace(space.signals, record=fresh)
    left = fresh.readings - fresh.setpoints @ fresh.layout.response.T
    space = replace(
        space,
        signals=signals,
        plain=space.transform.spectrum(left),
        courses=space.courses.hearing(signals),
    )
    return space.with_floor()
