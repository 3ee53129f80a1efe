"""What a workspace takes for known is corrected: the orbit, the currents, what was not read."""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.diagnose.likelihood.courses import Courses
from orbitfb.diagnose.likelihood.errors import following
from orbitfb.diagnose.likelihood.known import Known
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.screen.missing import drawn
from orbitfb.estimation.prediction import predicted
from orbitfb.estimation.transform import Matrix


def hearing(space: Workspace, added: Matrix) -> Workspace:
    """Predict the orbit anew, readings being wrong, and forget what laws made of it.

    Args:
        space: Of the record.
        added: What BPMs add to the readings, shape (N, n) [m].
    """
    record = space.signals.record
    modelled = record.setpoints @ record.layout.response.T
    residual = record.readings - modelled - added
    orbit = predicted(residual, space.noise, space.transform) + modelled
    signals = replace(space.signals, orbit=orbit)
    return replace(space, signals=signals, courses=space.courses.hearing(signals))


def driven(space: Workspace, currents: Matrix, kept: Mask) -> Workspace:
    """Take other currents for those that act on the beam: errors and laws follow them.

    Args:
        space: Of the record.
        currents: Shape (N, m) [A].
        kept: Columns of errors that made these currents, shape (k,): they stay as they are.
    """
    signals = replace(space.signals, currents=currents)
    return replace(
        space,
        signals=signals,
        terms=following(space.blocks, signals, space.transform, space.terms, kept),
        courses=Courses(signals, space.transform),
        known=Known.nothing(space.noise),
    )


def over(space: Workspace, other: Workspace) -> Workspace:
    """The same causes over the floor of another workspace, with its healthy scatters.

    Args:
        space: Whose causes they are.
        other: With more of them, whose errors may follow other currents.
    """
    lower = replace(
        space,
        shape=other.shape,
        weights=other.weights,
        trust=other.trust,
        shares=other.shares[: len(space.shares)],
    )
    if other.terms is space.terms:
        return replace(lower, noise=other.noise, known=other.known)
    return lower.with_noise(other.noise)


def drawn_apart(space: Workspace, field: Matrix) -> float:
    """How far a cause moves what was not read, beside the noise of readings [nats].

    So much may readings that were drawn without it say against it.

    Args:
        space: Without the cause.
        field: Spectrum of what it adds to the readings, shape (T, n) [m].
    """
    record = space.signals.record
    if not record.filled.any():
        return 0.0
    told = [space.transform.summed(made) for made in (_made(space), _made(space) + field)]
    without, beside = (drawn(record, one).readings for one in told)
    moved = (beside - without) ** 2 / space.noise.reading
    return 0.5 * float(np.sum(moved, where=record.filled))


def redrawn(space: Workspace, by: Workspace | None = None) -> Workspace:
    """Draw what was not read with all that is known now: healthy errors, and accepted causes.

    A draw that knows less says that they were not there at these rows.

    Args:
        space: Whose readings are drawn.
        by: What knows more of the same record; None: the same.
    """
    if not space.signals.record.filled.any():
        return space
    made = _made(space if by is None else by)
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


def _made(space: Workspace) -> Matrix:
    """What accepted causes and healthy errors add to the readings, shape (T, n) [m]."""
    return space.explained + space.terms.contribution(space.priors.mean(space.errors.pull))
