"""Has the last change acted when the orbit was taken? Else one error would be corrected twice.

Between two orbits the readbacks go from r − d to r, d being the change that was sent. So

    c = (readback − (r − d)) · d / d²

is 1 when the change has arrived and 0 when it has not, with the uncertainty σ / |d|, where σ is
what of the readbacks lies across d: noise, rounding and offsets tell how much they can tell.

A machine whose readbacks are always late is no machine that stands still: a change that is not
seen at the next orbit counts for something only as long as that is rare. But a machine that was in
time and is late from now on may have become slow in its puts: were they no longer waited for, the
loop would correct each error several times and drive the orbit away. So there it goes on waiting,
unless the orbit shows that the change has acted: then only the readbacks are slow.
"""

import math
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector

SEEN = 0.5
"""Least part of a change that must show."""

TELLING = 0.2
"""Largest uncertainty of that part; beyond it the readbacks say nothing."""

RARE = 0.25
"""Share of changes that showed late from which that is usual at this machine."""

PROMPT = 0.05
"""Share of late changes below which a machine is known to be in time."""

_SMOOTHING = 0.06


@dataclass(frozen=True)
class Sent:
    """What was sent last.

    Args:
        change: Shape (m,) [A]; None: nothing that might be on its way.
        late: Share of changes that did not show at the orbit after them, smoothed [1]. It begins
            where it is usual: nothing is waited for before a change was seen in time.
        waited: Orbits that were waited at for this change.
        prompt: Whether changes were in time once, as a rule.
        began: When the first of it was sent, monotonic [s].
    """

    change: Vector | None = None
    late: float = RARE
    waited: int = 0
    prompt: bool = False
    began: float = -math.inf


def arrived(
    readback: Vector, setpoints: Vector, counts: Mask, sent: Sent
) -> tuple[float | None, Sent]:
    """Look for the last change in the readbacks of an orbit.

    Args:
        readback: Shape (m,) [A]; NaN where none is known.
        setpoints: Believed to be in force, the last change included, shape (m,) [A].
        counts: Correctors that follow and whose readback is not older than the orbit, shape (m,).
        sent: So far.

    Returns:
        The part of it that shows if it is worth to wait for the rest, else None; and what to
        remember.
    """
    part = _part(readback, setpoints, counts, sent)
    if part is None:
        return None, sent
    late = part < SEEN
    waits = late and (sent.waited > 0 or sent.late < RARE or sent.prompt)
    # Each change counts once, when it is looked for first.
    share = sent.late if sent.waited else sent.late + _SMOOTHING * (late - sent.late)
    change, waited = sent.change if late else None, sent.waited + 1 if waits else 0
    after = Sent(change, share, waited, sent.prompt or share < PROMPT, sent.began)
    return (part if waits else None), after


def acted(step: Vector, predicted: Vector, floor: float) -> float | None:
    """Look for a change in the orbit itself.

    Args:
        step: Of the orbit since the change was sent, shape (n,) [m]; NaN where it is not known.
        predicted: What the change should do to it, shape (n,) [m].
        floor: Rms of a predicted step [m] below which nothing can be told.

    Returns:
        The part of the change that shows; None: the orbit does not tell.
    """
    known = np.isfinite(step)
    step, predicted = step[known], predicted[known]
    power = float(predicted @ predicted)
    if power < max(step.size, 1) * floor**2:
        return None
    part = float(step @ predicted) / power
    across = step - part * predicted
    spread = float(across @ across) / max(step.size - 1, 1)
    return part if spread <= TELLING**2 * power else None


def _part(readback: Vector, setpoints: Vector, counts: Mask, sent: Sent) -> float | None:
    """Give the part of the change that shows; None: they do not tell."""
    if sent.change is None:
        return None
    counts, change = counts & np.isfinite(readback) & np.isfinite(setpoints), sent.change
    if not counts.all():
        change, readback, setpoints = change[counts], readback[counts], setpoints[counts]
    power = float(change @ change)
    if power == 0.0:
        return None
    went = readback - (setpoints - change)
    part = float(went @ change) / power
    across = went - part * change
    spread = float(across @ across) / max(change.size - 1, 1)
    return part if spread <= TELLING**2 * power else None
