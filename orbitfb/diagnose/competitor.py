"""The competitor of every cause: a black-box refit of R̂ on the same ticks.

A ridge regression of the innovations on the filtered setpoints, mode by mode: the prediction-error
method, which is consistent in closed loop if the noise model is right (U. Forssell and L. Ljung,
Automatica 35 (1999) 1215). The width of the prior is chosen by the evidence of the ticks that are
fitted (D. J. C. MacKay, Neural Comput. 4 (1992) 415), so a record without a gap changes nothing.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.ladder import Ladder
from orbitfb.diagnose.replay import NOMINAL, Replay
from orbitfb.physics.optics import Matrix

_WIDTHS = np.geomspace(1e-4, 1.0, 25)
"""Prior scatter of the elements of the change, over the rms of those of R."""


def refitted_response(replay: Replay) -> Matrix:
    """Fit a change of R, of no particular form, to a record.

    Args:
        replay: The record; its floor and healthy errors are taken as they are.

    Returns:
        What to add to the nominal response, shape (n, m) [m/A].
    """
    floor, record = replay.floor, replay.record
    counted = replay.counted()
    white = replay.white(NOMINAL)[counted]
    deviation = replay.deviation
    ladder = Ladder(floor)
    distance = np.abs(np.subtract.outer(1.0 - floor.gains, np.array(ladder.feedback)))
    level = np.argmin(distance, axis=1)
    courses = ladder.filtered(record.setpoints, record.starts)
    rms = float(np.sqrt(np.mean(record.layout.response**2)))
    modal = np.zeros_like(record.layout.response)
    for index, course in enumerate(courses):
        members = np.flatnonzero(level == index)
        if len(members):
            kept = course[counted]
            modal[members] = _ridge(kept, white[:, members], deviation[members], rms)
    return floor.to_bpms(modal.T).T


def _ridge(course: Matrix, white: Matrix, deviation: Vector, rms: float) -> Matrix:
    """Coefficients of every mode on every corrector, shape (k, m) [m/A]."""
    size, axes = np.linalg.eigh(course.T @ course)
    size = np.maximum(size, 0.0)
    score = (axes.T @ (course.T @ white)) / deviation  # (m, k)
    info = size[:, None] / deviation**2
    best, width = 0.0, 0.0
    for trial in (_WIDTHS * rms) ** 2:
        spread = 1.0 + trial * info
        evidence = 0.5 * float(np.sum(trial * score**2 / spread - np.log(spread)))
        if evidence > best:
            best, width = evidence, float(trial)
    return (axes @ (width * score / (1.0 + width * info))).T
