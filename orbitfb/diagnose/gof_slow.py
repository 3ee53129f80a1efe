"""Whether what is left goes with a slow channel: stored current, a gap, a temperature."""

from collections.abc import Iterator

import numpy as np
from scipy import stats

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import GoodnessTest
from orbitfb.diagnose.bench import Bench
from orbitfb.effects.sensors.bpm_current import CHANNEL

CURRENT = "orbit that follows the stored current"
CHANNELS = "orbit that follows a slow channel"
_LEVEL = 0.05
"""Share by which limits are wider, for a floor whose level is not quite right."""


def slow_tests(bench: Bench, rate: float) -> tuple[GoodnessTest, ...]:
    """Regress what is left in every mode of the noise on every slow channel that moves.

    Every device may follow it by a little of its own, far too little to be seen at one: the sum
    over the modes is χ² of as many degrees of freedom, whatever the orbit is that goes with it.

    Args:
        bench: The record under the causes that were found.
        rate: How often a test may have a flag by chance.
    """
    channels = dict(_moving(bench))
    current = {name: own for name, own in channels.items() if name == CHANNEL}
    others = {name: own for name, own in channels.items() if name != CHANNEL}
    return tuple(
        _worst(title, bench, its, rate)
        for title, its in ((CURRENT, current), (CHANNELS, others))
        if its
    )


def _moving(bench: Bench) -> Iterator[tuple[str, Vector]]:
    """Channels that move, from nothing to one."""
    for name, values in bench.record.auxiliary.items():
        if np.isfinite(values).all() and (size := float(np.ptp(values))) > 0.0:
            yield name, (values - values.min()) / size


def _worst(title: str, bench: Bench, channels: dict[str, Vector], rate: float) -> GoodnessTest:
    found = {name: _squares(bench, course) for name, course in channels.items()}
    name = max(found, key=lambda one: found[one])
    modes = bench.white.shape[1]
    limit = float(stats.chi2.isf(rate / len(found), modes)) * (1.0 + _LEVEL)
    return GoodnessTest(
        name=title,
        value=found[name],
        limit=limit,
        flagged=found[name] > limit,
        note=f"χ² of {modes} modes, {name}",
        nats=max(0.5 * (found[name] - modes), 0.0),
    )


def _squares(bench: Bench, course: Vector) -> float:
    """Sum over the modes of the square of each one's score, over its information."""
    its = bench.floor.whiten_modes(
        np.tile(course[:, None], bench.white.shape[1]), bench.record.starts
    )
    loud = np.maximum(np.mean(bench.white[~bench.record.starts] ** 2, axis=0), 1.0)
    known = np.sum(its**2, axis=0) * loud
    score = np.sum(bench.white * its, axis=0)
    return float(np.sum(np.divide(score**2, known, out=np.zeros_like(score), where=known > 0.0)))
