"""What the tests of what is left say together: which counts, and of which stage it speaks."""

from orbitfb.diagnose.answer_blocks import Audit, GoodnessTest
from orbitfb.diagnose.gof_follow import BPMS, CORRECTORS
from orbitfb.diagnose.gof_pairs import NAME as TOGETHER
from orbitfb.diagnose.gof_places import JUMPS, SIZES
from orbitfb.diagnose.gof_slow import CHANNELS, CURRENT
from orbitfb.effects.kinds import Stage

_STAGES: dict[str, Stage] = {
    "line of all BPMs": "disturbance",
    "line of a BPM": "sensor",
    "rhythm of the scatter": "noise",
    "variance by BPM": "noise",
    "steadiness by BPM": "noise",
    "kurtosis by BPM": "noise",
    TOGETHER: "noise",
    JUMPS: "disturbance",
    SIZES: "actuator",
    BPMS: "sensor",
    CORRECTORS: "actuator",
    CURRENT: "sensor",
    CHANNELS: "disturbance",
    "mean by BPM": "sensor",
    "autocorrelation by BPM": "sensor",
    "largest reading": "sensor",
    "correlation with changes of a corrector": "actuator",
}
"""Where what a test finds most likely comes from; the others tell no stage."""


COURSES = frozenset({BPMS, CORRECTORS, CHANNELS, CURRENT})
"""Tests that noise of any kind passes, however loud."""


def clearest(its: Audit, among: frozenset[str] | None = None) -> GoodnessTest | None:
    """The flagged test that is worth most; None: no test has a flag.

    Args:
        its: All tests.
        among: Names of those that count; None: all.
    """
    flagged = [test for test in its.tests if test.flagged and (not among or test.name in among)]
    return max(flagged, key=lambda test: float(test.nats or 0.0), default=None)


def stage_of(test: GoodnessTest) -> Stage | None:
    """Tell where what a test finds most likely comes from; None: nobody knows."""
    return _STAGES.get(test.name)
