"""What happens beside the ticks, counted: refits, alarms, commands, looks at the gap."""

import math
import re
from collections import Counter, deque

from orbitfb.core.gap import GapSight
from orbitfb.core.ports import Clock
from orbitfb.core.printable import escaped
from orbitfb.core.refit import Alarm, AlarmCause, Decision, RefitReport
from orbitfb.observe.statistics.snapshot import Closing, Happening

KEPT_HAPPENINGS = 64
MOST_REASONS = 40
"""Reasons of refits that are counted apart; more are counted together."""
OTHER = "other"
_LONGEST_NAME = 64
_FIGURE = re.compile(r"(?<![A-Za-z])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?: (?:%|µm|mm|A|s|nats))?")


_NAME = re.compile(r"[^\s(),;]*\d[^\s(),;]*")
_SEVERAL = re.compile(r"…(?:(?:, | and )…)+")


class Tallies:
    """Counts and last ones; whoever calls holds the lock.

    Args:
        clock: The loop's clock.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.refits: Counter[Decision] = Counter()
        self.reasons: Counter[tuple[str, str, str]] = Counter()
        self.last_refit: RefitReport | None = None
        self.noise = math.nan
        """Noise of one BPM reading that a refit found last, rms [m]."""
        self.alarms: Counter[AlarmCause] = Counter()
        self.last_alarm: Alarm | None = None
        self.gap: GapSight | None = None
        self.commands = {"given": 0, "refused": 0}
        self.closing: Closing | None = None
        self.happenings: deque[Happening] = deque(maxlen=KEPT_HAPPENINGS)
        self._happened = 0

    def refitted(self, report: RefitReport) -> None:
        """Count a refit."""
        self.refits[report.decision] += 1
        key = (report.decision.value, report.stage.value, without_figures(report.reason))
        if key not in self.reasons and len(self.reasons) >= MOST_REASONS:
            key = (report.decision.value, report.stage.value, OTHER)
        self.reasons[key] += 1
        self.last_refit = report
        self.noise = report.figures.get("reading_noise", self.noise)
        word = report.decision.value.replace("_", " ")
        self.note("refit", f"{report.policy_id} {word}: {report.reason}")

    def alarmed(self, alarm: Alarm) -> None:
        """Count an alarm of the learner."""
        self.alarms[alarm.cause] += 1
        self.last_alarm = alarm
        self.note(
            "alarm",
            (
                f"orbits differ from the predictions ({alarm.cause}): {alarm.statistic:.3g}, limit "
                f"{alarm.threshold:.3g}"
            ),
        )

    def gap_seen(self, sight: GapSight) -> None:
        """Keep a look at the gap."""
        before, self.gap = self.gap, sight
        if sight.resolved and not (before is not None and before.resolved):
            self.note("gap", f"{sight.nats:.3g} nats/tick, {sight.effect} suspected")

    def commanded(
        self,
        name: str,
        user: str,
        host: str,
        refusal: str = "",
        *,
        idle: bool = False,
        times: int = 1,
        told: bool = True,
    ) -> None:
        """Count a command; see `LoopStatistics.commanded`. One that is `idle` changed nothing."""
        self.commands["refused" if refusal else "given"] += times
        if name == "close" and not refusal and not idle:
            self.closed_by(user, host)
        if told:
            why = f" refused: {refusal}" if refusal else ""
            self.note("command", f"{name} by {user}@{host}{why}")

    def closed_by(self, user: str, host: str) -> None:
        """Keep who closed the loop."""
        self.closing = Closing(user[:_LONGEST_NAME], host[:_LONGEST_NAME], self._clock.wall())

    def note(self, kind: str, text: str) -> None:
        """Keep a line for people."""
        self._happened += 1
        self.happenings.append(Happening(self._happened, self._clock.wall(), kind, escaped(text)))


def kind_of(reason: str) -> str:
    """Give the kind of a reason: without figures and without names that have some.

    A label made of it has few values, however many incidents there are.

    Args:
        reason: A sentence with figures and names of devices.
    """
    plain = _NAME.sub("…", without_figures(reason))
    return _SEVERAL.sub("…", plain)


def without_figures(reason: str) -> str:
    """Take the figures out of a reason, so that the same reason is counted as the same.

    Args:
        reason: A sentence with figures.
    """
    return _FIGURE.sub("…", reason)[:160]
