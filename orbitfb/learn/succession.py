"""From an accepted candidate to the policy in force, and back: shadow, promotion, watch.

accepted ─► shadow ─► promoted ─► watched ─► kept
              └► refused             └► rolled back, and never promoted again
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from orbitfb.core.ports import Clock, Policy
from orbitfb.core.refit import Decision, RefitReport, Stage
from orbitfb.core.transitions import Transitions
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.shadow import Shadow
from orbitfb.learn.watch import BASELINE, Watch, observed_rms, usual_of
from orbitfb.safety.limits import LimitSettings

Keep = Callable[[Policy, RefitReport], None]
Tell = Callable[[RefitReport], None]


class Slot(Protocol):
    """Where the loop takes its policy from."""

    @property
    def current(self) -> Policy:
        """The policy in force."""
        ...

    def swap_from(self, expected: Policy, policy: Policy) -> bool:
        """Put a policy in force unless another than the expected one is; say whether it is."""
        ...


class Records(Protocol):
    """What is on record about policies in force, beyond the life of this program."""

    def proved(self, identifier: str) -> None:
        """Put on record that a promoted policy passed its watch."""
        ...

    def suspended(self, identifier: str, seen: int) -> None:
        """Leave the watch over a promoted policy, seen for so many ticks, to the next service."""
        ...

    def fault_of(self, identifier: str) -> str:
        """Say how a policy failed in force; empty when nothing is known against it."""
        ...


class NoRecords:
    """Nothing is on record."""

    def proved(self, identifier: str) -> None:
        """Forget it."""

    def suspended(self, identifier: str, seen: int) -> None:
        """Forget it."""

    def fault_of(self, identifier: str) -> str:
        """Know nothing."""
        return ""


class TransitionSource(Protocol):
    """Where the last transitions are kept."""

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Copy the transitions: the last ones, or those since a tick."""
        ...


@dataclass(frozen=True, slots=True)
class _Trial:
    """A candidate in shadow, and who is to be told what becomes of it."""

    shadow: Shadow
    report: RefitReport
    tell: Tell


def _overtaken(report: RefitReport) -> RefitReport:
    reason = "another policy was put in force while the candidate ran in shadow"
    return replace(report, decision=Decision.REFUSED, reason=reason)


class Succession:
    """Keeps the candidate on trial and the swap under watch; both are at most one.

    Args:
        settings: Of shadow, watch and roll-back.
        history: The last transitions.
        slot: The policy in force.
        keep: Stores a policy before it is put in force; for a roll-back, the policy restored.
        limits: Of a write.
        tripped: Whether the loop has tripped.
        clock: For the reports and the patience with candidates.
        records: What is known of policies beyond the life of this program.
    """

    def __init__(
        self,
        settings: LearnSettings,
        history: TransitionSource,
        slot: Slot,
        keep: Keep,
        limits: LimitSettings,
        tripped: Callable[[], bool],
        clock: Clock,
        records: Records,
    ) -> None:
        self._settings, self._history, self._slot = settings, history, slot
        self._keep, self._limits = keep, limits
        self._tripped, self._clock = tripped, clock
        self._trial: _Trial | None = None
        self._watch: Watch | None = None
        self._records = records
        self._left: dict[str, str] = {}

    @property
    def trying(self) -> bool:
        """Whether a candidate runs in shadow."""
        return self._trial is not None

    def begin(self, candidate: Policy, incumbent: Policy, report: RefitReport, tell: Tell) -> None:
        """Take an accepted candidate.

        Args:
            candidate: What may act.
            incumbent: What it was judged against.
            report: Of the judge.
            tell: Gets the report when it is known what became of the candidate.
        """
        known = self._left.get(candidate.policy_id) or self._records.fault_of(candidate.policy_id)
        if known:
            reason = f"this policy was in force before and does not come again: it {known}"
            tell(replace(report, decision=Decision.REFUSED, reason=reason))
        elif self._settings.shadow.ticks == 0:
            self._promote(candidate, incumbent, report, tell)
        else:
            expected = report.figures.get("predicted_rms_candidate", 0.0)
            shadow = Shadow(
                candidate,
                incumbent,
                getattr(candidate, "response"),  # noqa: B009 - the port does not promise one
                self._settings.shadow,
                self._limits,
                self._newest() + 1,
                self._clock.monotonic(),
                expected / self._settings.rollback_factor,
            )
            self._trial = _Trial(shadow, report, tell)

    def try_candidate(self) -> None:
        """Let the candidate in shadow look at the new orbits, and decide about it."""
        trial = self._trial
        if trial is None:
            return
        shadow, now = trial.shadow, self._clock.monotonic()
        report = replace(trial.report, stage=Stage.SHADOW)
        if self._slot.current is not shadow.incumbent:
            self._trial = None
            trial.tell(_overtaken(report))
            return
        shadow.take(self._history.snapshot(since_tick=shadow.next_tick), now)
        verdict = shadow.verdict(now)
        if verdict is None:
            return
        self._trial = None
        report = replace(report, figures={**report.figures, **verdict.figures})
        if verdict.accepted:
            report = replace(report, reason=f"{report.reason}; {verdict.reason}")
            self._promote(shadow.candidate, shadow.incumbent, report, trial.tell)
        else:
            trial.tell(replace(report, decision=Decision.REFUSED, reason=verdict.reason))

    def watch_swap(self) -> RefitReport | None:
        """Go back to the former policy when the orbit has become worse since the swap.

        Returns:
            The report of a roll-back, without its number.
        """
        watch = self._watch
        if watch is None:
            return None
        if self._slot.current is not watch.promoted:  # an operator chose another one meanwhile
            self._watch = None
            return None
        new = self._history.snapshot(since_tick=watch.next_tick)
        reason = watch.look(new, self._settings)
        if not reason and self._tripped() and not watch.tripped_before:
            reason = f"the loop tripped {watch.seen} ticks after the swap"
        if reason:
            return self._roll_back(watch, reason)
        if watch.seen >= self._settings.watch:
            self._watch = None
            self._records.proved(watch.promoted.policy_id)
        return None

    def resume(self, former: Policy, before: float | None, seen: int) -> None:
        """Go on watching the policy in force, which an earlier service promoted.

        Args:
            former: The policy to go back to.
            before: Observed orbit before the swap, rms [m]; None: not known, so that only a trip
                takes the policy back.
            seen: Ticks for which it was watched [ticks].
        """
        factor, level = self._settings.rollback_factor, np.inf if before is None else before
        usual = usual_of(np.zeros(0), factor, level)
        watch = Watch(self._slot.current, former, usual, self._newest() + 1, self._tripped())
        watch.seen = seen
        self._watch = watch

    def end(self) -> None:
        """Give up the candidate on trial, of which nobody is told, and suspend the watch."""
        self._trial = None
        if (watch := self._watch) is not None and self._slot.current is watch.promoted:
            self._records.suspended(watch.promoted.policy_id, watch.seen)

    def _promote(
        self, candidate: Policy, incumbent: Policy, report: RefitReport, tell: Tell
    ) -> None:
        before = observed_rms(self._history.snapshot(last=BASELINE))
        if self._slot.current is not incumbent:
            tell(_overtaken(report))
            return
        usual = usual_of(before, self._settings.rollback_factor)
        told = {"rms_before": usual.level} if np.isfinite(usual.level) else {}
        report = replace(report, decision=Decision.PROMOTED, figures={**report.figures, **told})
        self._keep(candidate, report)
        if not self._slot.swap_from(incumbent, candidate):
            back = replace(report, decision=Decision.ROLLED_BACK)
            self._keep(self._slot.current, back)  # what an operator chose stays the active one
            tell(_overtaken(report))
            return
        since, tripped = self._newest() + 2, self._tripped()
        self._watch = Watch(candidate, incumbent, usual, since, tripped)
        tell(report)

    def _roll_back(self, watch: Watch, reason: str) -> RefitReport | None:
        left, self._watch = watch.promoted, None
        if not self._slot.swap_from(left, watch.former):
            return None
        self._left[left.policy_id] = f"was rolled back: {reason}"
        report = RefitReport(
            number=0,
            time=self._clock.wall(),
            trigger="watch",
            rows=0,
            decision=Decision.ROLLED_BACK,
            reason=reason,
            policy_id=left.policy_id,
            incumbent_id=watch.former.policy_id,
            figures={"watched_ticks": float(watch.seen), "rms_before": watch.usual.level},
            duration=0.0,
            stage=Stage.WATCH,
        )
        self._keep(watch.former, report)
        return report

    def _newest(self) -> int:
        latest = self._history.snapshot(last=1)
        return int(latest.tick[-1]) if len(latest) else -1
