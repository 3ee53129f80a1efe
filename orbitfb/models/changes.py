"""Tell a drift of R from noise: a change detector with a stated rate of false alarms.

Every block of rows gives `pull` and `information` of a `orbitfb.models.comparison.Contrast`: if R
is as it was, the step pull − information / 2 is normal with the mean −I/2 and the variance I
(I the information), a log-likelihood ratio. Page's sum

    W ← max(0, W + step),   alarm when W ≥ h,

then passes h by chance once in (D. Siegmund, Sequential Analysis, 1985, ch. 2.6; the walk in
units of √I, its mean μ = −√I/2, the threshold with the overshoot b = h/√I + 1.166)

    blocks between false alarms = (exp(2|μ|b) − 1 − 2|μ|b) / (2μ²),

which has a minimum over I: h is solved for the worst case, I that gives the fewest blocks, each
block as short as one tick, and a tenth more blocks (drawn walks pass up to a tenth more often than
the approximation says). No figure of ring or noise enters.

Three things keep it honest where the noise model is not exact. A noise that is misjudged is
divided out: the mean squared innovation since the last swap (never below 1) is the reference.
An allowance per row is taken off, for what a slightly wrong noise model can feign. And a block
cannot count for more than a share of h: one huge row is a kick, not a drift. The last two can
only make false alarms rarer.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from orbitfb.models.comparison import Contrast
from orbitfb.models.settings import ChangeSettings

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

_DAY = 86_400.0
_OVERSHOOT = 1.166
_MOST_NATS = 500.0
_APPROXIMATION = 1.1


@dataclass(frozen=True, slots=True)
class Alarm:
    """R is no longer what the running policy believes.

    Args:
        evidence: Page's sum [nats].
        threshold: What it passed [nats].
        rows: Rows since the last reset.
        rising: Rows since the sum last stood at zero: about how long ago the change came.
        sensitivity: What the rows since the last reset are worth [nats].
    """

    evidence: float
    threshold: float
    rows: int
    rising: int
    sensitivity: float

    @property
    def reason(self) -> str:
        """In one sentence with figures."""
        return (
            f"the response has changed: the innovations of {self.rising} rows follow the "
            f"corrections with {self.evidence:.1f} nats (threshold {self.threshold:.1f})"
        )


class ChangeDetector:
    """Page's sum over the contrasts of one response.

    Args:
        settings: Rate of false alarms, allowances.
        rate: Ticks per second [Hz].

    Attributes:
        threshold: Of the sum [nats].
        evidence: The sum as it stands [nats].
        rows: Rows since the last reset.
        sensitivity: What they are worth [nats].
    """

    def __init__(self, settings: ChangeSettings, rate: float) -> None:
        self.settings = settings
        self.threshold = threshold_for(_DAY * rate / settings.false_alarms_per_day)
        self.reset()

    def reset(self) -> None:
        """Begin anew, as after a swap: another response is in question."""
        self.evidence = 0.0
        self.rows = 0
        self.sensitivity = 0.0
        self._rising = 0
        self._squares = 0.0
        self._weight = 0.0

    @property
    def informed(self) -> bool:
        """Whether the rows since the last reset could have shown a change that matters."""
        return self.sensitivity >= self.settings.minimum_sensitivity

    def absorb(self, contrast: Contrast) -> Alarm | None:
        """Take in a block.

        Args:
            contrast: Of rows later than all before, under the same response since the reset.

        Returns:
            An alarm while the sum is above the threshold; it stays there until a reset or until
            rows speak against a change.
        """
        if contrast.rows == 0:
            return None
        settings = self.settings
        reference = max(1.0, self._squares / self._weight) if self._weight else 1.0
        step = (contrast.pull - 0.5 * contrast.information) / reference
        step -= settings.allowance * contrast.rows
        step = min(step, settings.largest_share * self.threshold)
        self.evidence = max(0.0, self.evidence + step)
        self._rising = self._rising + contrast.rows if self.evidence > 0.0 else 0
        self.rows += contrast.rows
        self.sensitivity += contrast.sensitivity
        fade = math.exp(-contrast.rows / settings.reference_rows)
        self._squares = fade * self._squares + contrast.rows * contrast.chi2
        self._weight = fade * self._weight + contrast.rows
        if self.evidence < self.threshold or not self.informed:
            return None
        return Alarm(self.evidence, self.threshold, self.rows, self._rising, self.sensitivity)


def blocks_between_alarms(threshold: float, information: float) -> float:
    """Blocks from a reset to a false alarm, on average: Siegmund's approximation.

    Args:
        threshold: h [nats].
        information: I of every block [nats].
    """
    scale = math.sqrt(information)
    exponent = threshold + _OVERSHOOT * scale
    return (math.expm1(min(exponent, 700.0)) - exponent) / (0.5 * information)


def threshold_for(blocks: float) -> float:
    """Solve for the threshold that gives at least so many blocks between false alarms.

    Args:
        blocks: On average, for whatever information the blocks carry.

    Returns:
        h [nats].
    """
    from scipy.optimize import brentq  # half a second, and only the trainer needs it

    def excess(threshold: float) -> float:
        return math.log(fewest_blocks(threshold)[0]) - math.log(max(_APPROXIMATION * blocks, 2.0))

    if excess(0.1) >= 0.0:
        return 0.1
    return cast(float, brentq(excess, 0.1, _MOST_NATS))


def fewest_blocks(threshold: float) -> tuple[float, float]:
    """Give the fewest blocks between false alarms, and the information of a block where it is so.

    Args:
        threshold: h [nats].
    """
    from scipy.optimize import minimize_scalar

    found = cast(
        "OptimizeResult",
        minimize_scalar(
            lambda logarithm: math.log(blocks_between_alarms(threshold, math.exp(logarithm))),
            bounds=(-3.0, 3.0),
            method="bounded",
        ),
    )
    return math.exp(found.fun), math.exp(found.x)
