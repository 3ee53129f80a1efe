"""Readings that were not read, drawn anew once more of the record is explained."""

from dataclasses import replace

from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.screen.missing import drawn
from orbitfb.estimation.priors import DRAWN_AGAIN


def redrawn(space: Workspace) -> Workspace:
    """Draw what was not read with all that is known now: healthy errors, and accepted causes.

    A draw that knows less says that they were not there at these rows. Records that miss next to
    nothing are left as they are.
    """
    record = space.signals.record
    if record.filled.mean() < DRAWN_AGAIN:
        return space
    made = space.explained + space.terms.contribution(space.priors.mean(space.errors.pull))
    fresh = drawn(record, space.transform.summed(made))
    signals = replace(space.signals, record=fresh)
    left = fresh.readings - fresh.setpoints @ fresh.layout.response.T
    space = replace(
        space,
        signals=signals,
        plain=space.transform.spectrum(left),
        courses=space.courses.hearing(signals),
    )
    return space.with_floor()
