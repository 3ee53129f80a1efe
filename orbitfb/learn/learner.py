"""One refit: take rows in, build a candidate, judge it. No threads here."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import EstimationError
from orbitfb.core.ports import Clock, Policy
from orbitfb.core.refit import Alarm, AlarmCause, Decision, RefitReport
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.estimation.columns import KnownRf
from orbitfb.learn.judge import Evidence, Verdict, gain_of, judge
from orbitfb.learn.reach import mean_error, unreachable_rms
from orbitfb.learn.rf_steps import rf_figures, rf_refusal, rf_told
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.since import Since, counts, model_figures
from orbitfb.learn.watch import swap_cost
from orbitfb.models.absorbed import Absorbed
from orbitfb.models.changes import ChangeDetector
from orbitfb.models.identify import Identifier
from orbitfb.models.linear import LinearModel
from orbitfb.models.rows import select_rows
from orbitfb.policies.rf_known import rf_of, with_rf

Build = Callable[[LinearModel, Policy], Policy]
"""Makes a candidate of the posterior and of the incumbent."""


class Learner:
    """Keeps the estimate of R and makes candidates of it.

    Works online, on what it has not seen yet, and offline, from the prior over a whole archive.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A].
        settings: How to identify and to judge.
        build: Makes a candidate.
        clock: For the reports.
        seed: Of the responses that the judge draws.
        rate: Ticks per second [Hz], for the rate of false alarms.
        rf: What is told of the RF; None: rows in which it stepped do not teach.
    """

    def __init__(
        self,
        response: Vector,
        settings: LearnSettings,
        build: Build,
        clock: Clock | None = None,
        seed: int = 0,
        rate: float = 10.0,
        rf: KnownRf | None = None,
    ) -> None:
        self.settings, self._rf = settings, rf
        self._identifier = Identifier(response, settings.identify, rf)
        self._first_response = response
        self._build = build
        self._clock = clock or SystemClock()
        self._generator = np.random.default_rng(seed)
        self._number = 0
        self._since = Since(None)
        self._forgotten: int | None = None
        self._detector = ChangeDetector(settings.changes, rate)
        self._alarm: Alarm | None = None
        self._degraded = False
        self._error: Vector | None = None
        self._learns, self._explains = False, float("inf")

    @property
    def model(self) -> LinearModel:
        """The posterior as it stands."""
        return self._identifier.model

    @property
    def last_tick(self) -> int | None:
        """Tick of the last row that taught; None before the first."""
        last = self._identifier.last_tick
        return self._forgotten if last is None else last

    def absorb(
        self, transitions: Transitions, incumbent: Policy, at_once: bool = False
    ) -> Absorbed:
        """Take in the transitions that are new; cheap, decides nothing.

        Args:
            transitions: May begin with rows that were taken in before.
            incumbent: The policy in force, whose response is compared.
            at_once: Whether it is a whole record: then R̂ is not asked whether it explains rows
                before they are used, which on a ring that drifts it cannot over hundreds of them.

        Returns:
            What the new rows say; `chi2_other` is about the incumbent's response.
        """
        if self._since.policy_id != incumbent.policy_id:
            self._since = Since(incumbent.policy_id)
            self.watch_afresh()
        self._learns = bool(getattr(incumbent, "learns", False))
        self._explains = float(getattr(incumbent, "chi2", float("inf")))
        error = mean_error(transitions)
        self._error = self._error if error is None else error
        rows = select_rows(transitions, self.settings.tolerance, self._rf is not None)
        # Whether a bump or another reference spoils the last row, only the next one tells.
        rows = rows.take(0, int(np.searchsorted(rows.tick, transitions.tick[-1:].sum())))
        if self.last_tick is not None:
            known = int(np.searchsorted(rows.tick, self.last_tick, side="right"))
            rows = replace(rows.take(known), left_out=rows.left_out)
        absorbed = self._identifier.absorb(
            rows, self._response_of(incumbent), self._column_of(incumbent)
        )
        self._since.add(rows, absorbed, None if at_once else self.settings.chi2_trigger)
        self._look(absorbed)
        return absorbed

    @property
    def degraded(self) -> bool:
        """Whether the incumbent's response is not the ring's, and there is enough to refit from."""
        return self._degraded and self._obstacle(self._since) is None

    def take_alarm(self) -> Alarm | None:
        """Give a new alarm once."""
        alarm, self._alarm = self._alarm, None
        return alarm

    def forget(self, incumbent: Policy) -> None:
        """Believe the incumbent's response again, and none of the rows up to now.

        Args:
            incumbent: The policy in force.
        """
        self._forgotten = self.last_tick
        self._identifier = Identifier(
            self._response_of(incumbent), self.settings.identify, self._rf
        )
        self._since = Since(incumbent.policy_id)
        self.watch_afresh()

    def watch_afresh(self) -> None:
        """Begin the watch for a degradation anew."""
        self._degraded = False
        self._detector.reset()

    def _look(self, absorbed: Absorbed) -> None:
        """Ask whether the incumbent's response still explains the rows."""
        limit, seen = self.settings.chi2_trigger, None
        for contrast in absorbed.contrasts:
            seen = self._detector.absorb(contrast)
        if self._degraded:
            return
        surprised = absorbed.rows > 0 and absorbed.chi2_other > limit
        # While R drifts quickly the policy follows as often as the rows are looked at.
        follows = self.settings.follow_drift and self._identifier.drift > 0
        self._degraded = surprised or seen is not None or follows
        if seen is not None:
            self._alarm = Alarm(
                self.last_tick or 0,
                AlarmCause.DRIFT,
                float(seen.rising),
                seen.evidence,
                seen.threshold,
            )
        if not surprised:
            return
        self._alarm = Alarm(
            self.last_tick or 0,
            AlarmCause.SURPRISE,
            float(absorbed.rows),
            absorbed.chi2_other,
            limit,
        )

    def refit(
        self, transitions: Transitions, incumbent: Policy, trigger: str
    ) -> tuple[RefitReport, Policy | None]:
        """Take in what is new, build a candidate and judge it.

        Args:
            transitions: May begin with rows that were taken in before.
            incumbent: The policy to beat.
            trigger: `periodic`, `on-demand` or `degradation`; goes into the report.

        Returns:
            The report (ACCEPTED: may be put in force; REFUSED) and the candidate; None when no
            candidate was built.

        Raises:
            EstimationError: No row has ever been fit to learn from; says why.
        """
        began = self._clock.monotonic()
        self.absorb(transitions, incumbent, at_once=True)
        return self.conclude(incumbent, trigger, began)

    def conclude(
        self, incumbent: Policy, trigger: str, began: float | None = None
    ) -> tuple[RefitReport, Policy | None]:
        """Build a candidate from what was taken in and judge it; see `refit`.

        Args:
            incumbent: The policy to beat.
            trigger: Goes into the report.
            began: When the work began, monotonic [s]; None: now.

        Raises:
            EstimationError: No row has ever been fit to learn from; says why.
        """
        began = self._clock.monotonic() if began is None else began
        since = self._since
        if trigger == "degradation":
            self.watch_afresh()  # what was seen is acted upon
        if self.last_tick is None:
            raise EstimationError(
                "none of the transitions can be used to identify the response "
                f"({counts(since.left_out)}); record with the loop CLOSED and readbacks that "
                "follow the setpoints"
            )
        model = self.model
        figures = since.figures() | model_figures(model, self._response_of(incumbent))
        figures |= rf_figures(model.rf, since.rf_steps)
        candidate, verdict = None, self._obstacle(since)
        refuted = since.nats < -self.settings.judge.evidence
        if verdict is None:
            candidate, refused = self._build(model, incumbent), rf_refusal(model.rf)
            if model.rf is not None and candidate is not incumbent:
                with_rf(candidate, (rf_of(incumbent) or self._rf) if refused else model.rf.known)
            evidence = Evidence(since.take_nats(), since.page)
            verdict = judge(
                candidate, incumbent, model, evidence, self.settings.judge, self._generator,
                swap_cost(self.settings), self._unreachable(model, candidate),
                since.hertz_square / max(since.rows, 1),
            )  # fmt: skip
        if refuted:
            self.forget(incumbent)
            verdict = replace(
                verdict, reason=f"{verdict.reason}; R̂ starts again from that of the incumbent"
            )
        self._number += 1
        report = RefitReport(
            number=self._number,
            time=self._clock.wall(),
            trigger=trigger,
            rows=since.rows,
            decision=Decision.ACCEPTED if verdict.accepted else Decision.REFUSED,
            reason=rf_told(verdict.reason, model.rf, since.rf_steps),
            policy_id=incumbent.policy_id if candidate is None else candidate.policy_id,
            incumbent_id=incumbent.policy_id,
            figures={**figures, **verdict.figures},
            duration=self._clock.monotonic() - began,
        )
        return report, candidate

    def _obstacle(self, since: Since) -> Verdict | None:
        if since.rows < self.settings.minimum_rows:
            return Verdict(
                False,
                f"only {since.rows} rows since {since.policy_id} is in force, "
                f"{self.settings.minimum_rows} are needed ({counts(since.left_out)})",
                {},
            )
        if since.change_square == 0.0:
            return Verdict(
                False,
                f"no excitation: nothing was written in {since.rows} rows; close the loop",
                {},
            )
        enough, trigger = self.settings.judge.evidence, self.settings.chi2_trigger
        if since.asked and since.chi2 > trigger:
            return Verdict(
                False,
                f"R̂ does not explain the newest rows (χ² {since.chi2:.3g}, limit {trigger:g}): it "
                "learns from them if the ring stays as it is now",
                {},
            )
        if self._learns and (since.page < enough or self._explains < trigger):
            # What it does is more than its gain at rest, and it knows how far it doubts its R̂.
            return Verdict(
                False,
                f"{since.policy_id} learns by itself, and the rows do not refute what it knows "
                f"({since.page:.1f} of {enough:.1f} nats; its own χ² {self._explains:.3g}, limit "
                f"{trigger:g})",
                {},
            )
        return None

    def _unreachable(self, model: LinearModel, candidate: Policy) -> float:
        """Of the last orbit errors, what no corrector that moves reaches, rms [m]."""
        if self._error is None:
            return 0.0
        response = model.response
        moving = np.abs(gain_of(candidate, len(response))).max(axis=1) > 0.0
        return unreachable_rms(self._error, response, moving)

    def _response_of(self, policy: Policy) -> Vector:
        response = getattr(policy, "response", None)
        return self._first_response if response is None else response

    def _column_of(self, policy: Policy) -> Vector | None:
        known = rf_of(policy)
        return None if known is None else known.response
