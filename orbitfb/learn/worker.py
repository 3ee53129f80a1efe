"""The learner's thread: when to refit, what to do with the verdict, when to take it back.

    snapshot ─► trainer: refit, improve, judge ─► shadow ─► promote ─► watch ─► roll back

The arithmetic is the trainer's, here or in a process of its own. This thread never waits for it,
so that a swap is watched whatever the trainer does.
"""

import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from orbitfb.core.clock import SystemClock
from orbitfb.core.ports import Clock, Policy
from orbitfb.core.refit import Alarm, Decision, RefitReport, Stage
from orbitfb.core.transitions import Transitions
from orbitfb.learn.shadow import Shadow
from orbitfb.learn.trainer import Answer, Keep, Publish, Task, Trainer, explain
from orbitfb.learn.watch import BASELINE, Watch, observed_rms
from orbitfb.safety.limits import LimitSettings

_POLL = 0.2


class Slot(Protocol):
    """Where the loop takes its policy from."""

    @property
    def current(self) -> Policy:
        """The policy in force."""
        ...

    def swap(self, policy: Policy) -> Policy:
        """Put a policy in force and return the one that was."""
        ...


class TransitionSource(Protocol):
    """Where the last transitions are kept."""

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Copy the transitions: the last ones, or those since a tick."""
        ...


@dataclass(frozen=True, slots=True)
class _Request:
    """Somebody asks for a refit; `future` is None when it is the thread itself."""

    future: Future[RefitReport] | None
    activate: bool


@dataclass(frozen=True, slots=True)
class _Trial:
    """A candidate in shadow, and who waits for what becomes of it."""

    shadow: Shadow
    report: RefitReport
    request: _Request


class LearnerThread(threading.Thread):
    """Refits beside the loop and swaps its policy.

    Everything happens in `step`, which a test may call without starting the thread.

    Args:
        trainer: Identification, candidates and judgement.
        history: The last transitions.
        slot: The policy in force.
        publish: Gets every report, in this thread; it must not raise.
        keep: Stores a policy that was accepted or promoted with its report, before it is put in
            force; for a roll-back, the policy restored; None: nothing is stored.
        poll: How often to look for new ticks [s].
        limits: Of a write, for the candidates in shadow.
        alarmed: Gets every alarm, in this thread; it must not raise.
        tripped: Whether the loop has tripped; a policy that trips it is left.
        clock: For the reports and the patience with candidates.
    """

    def __init__(
        self,
        trainer: Trainer,
        history: TransitionSource,
        slot: Slot,
        publish: Publish,
        keep: Keep | None = None,
        poll: float = _POLL,
        limits: LimitSettings | None = None,
        alarmed: Callable[[Alarm], None] = lambda _: None,
        tripped: Callable[[], bool] = lambda: False,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(name="learner", daemon=True)
        self._trainer, self._history, self._slot = trainer, history, slot
        self._publish, self._keep, self._poll = publish, keep, poll
        self._limits = limits or LimitSettings()
        self._alarmed, self._tripped = alarmed, tripped
        self._clock = clock or SystemClock()
        self._wake = threading.Event()
        self._stopping = False
        self._requests: list[_Request] = []
        self._lock = threading.Lock()
        self._number = 0
        self._checked: int | None = None
        self._refitted: int | None = None
        self._afresh = False
        self._asked: tuple[_Request, Policy] | None = None
        self._trial: _Trial | None = None
        self._watch: Watch | None = None
        self._left: set[str] = set()

    def request(self, activate: bool = True) -> Future[RefitReport]:
        """Ask for a refit now.

        Args:
            activate: Whether an accepted candidate is put in force, or only kept.

        Returns:
            The report, when it is there: for a candidate that is to be put in force, after its
            time in shadow.
        """
        future: Future[RefitReport] = Future()
        with self._lock:
            self._requests.append(_Request(future, activate))
        self._wake.set()
        return future

    def stop(self, timeout: float = 1.0) -> None:
        """Let the thread end and the trainer go; requests that wait are cancelled."""
        self._stopping = True
        self._wake.set()
        if self.is_alive():
            self.join(timeout)
        self._trainer.close()
        with self._lock:
            requests, self._requests = self._requests, []
        waiting = [self._asked[0]] if self._asked else []
        waiting += [self._trial.request] if self._trial else []
        for request in requests + waiting:
            if request.future is not None and not request.future.cancel():
                request.future.set_exception(CancelledError())

    def run(self) -> None:
        """Look for work until stopped."""
        while not self._stopping:
            self.step()
            self._wake.wait(self._poll)
            self._wake.clear()

    def step(self) -> None:
        """Do what is due now; nothing here takes long unless the trainer is in this thread."""
        for part in (self._collect, self._watch_swap, self._try_candidate, self._ask):
            try:
                part()
            except Exception as error:  # the outermost guard of the thread: reported, never lost
                self._fail("periodic", explain(error), None)

    def _ask(self) -> None:
        """Give the trainer what is due: a request, or the rows that are new."""
        if self._asked is not None or not self._trainer.ready:
            return
        request = self._next_request()
        last = self._trainer.last_tick
        new = self._history.snapshot(since_tick=None if last is None else last + 1)
        if request is None:
            task = self._due(new)
            request = _Request(None, activate=True)
        else:
            task = Task(new, self._slot.current, "on-demand", afresh=self._afresh)
        if task is None:
            return
        if task.trigger is not None:
            self._refitted = self._newest(new)
        self._afresh = False
        self._asked = (request, task.incumbent)
        try:
            self._trainer.submit(task)
        except Exception as error:
            self._asked = None
            self._fail(task.trigger or "periodic", explain(error), request)
            return
        self._collect()

    def _next_request(self) -> _Request | None:
        """Take the oldest request; it waits while a candidate is on trial."""
        with self._lock:
            while self._requests and self._trial is None:
                request = self._requests.pop(0)
                if request.future is None or request.future.set_running_or_notify_cancel():
                    return request
        return None

    def _due(self, new: Transitions) -> Task | None:
        settings = self._trainer.settings
        if len(new) == 0:
            return None
        newest = int(new.tick[-1])
        if self._checked is None:
            self._checked = self._refitted = int(new.tick[0]) - 1
        if newest - self._checked < settings.check:
            return None
        self._checked = newest
        free = settings.enabled and self._trial is None
        due = self._refitted is None or newest - self._refitted >= settings.every
        trigger = "periodic" if due and free else None
        return Task(new, self._slot.current, trigger, may_refit=free, afresh=self._afresh)

    def _newest(self, new: Transitions) -> int | None:
        return int(new.tick[-1]) if len(new) else self._refitted

    def _collect(self) -> None:
        """Take the trainer's answer and do what it calls for."""
        answer = self._trainer.collect()
        if answer is None:
            return
        # Without having been asked it tells that it has died.
        asked = self._asked or (_Request(None, activate=True), self._slot.current)
        (request, incumbent), self._asked = asked, None
        if answer.alarm is not None:
            self._alarmed(answer.alarm)
        if answer.failure:
            self._fail(answer.trigger or "periodic", answer.failure, request)
        elif answer.report is not None:
            if answer.trigger == "degradation":
                self._refitted = self._checked
            self._consider(answer, answer.report, incumbent, request)

    def _consider(
        self, answer: Answer, report: RefitReport, incumbent: Policy, request: _Request
    ) -> None:
        candidate = answer.candidate
        report = replace(report, number=self._next_number())
        if report.decision is not Decision.ACCEPTED or candidate is None:
            self._end(report, request)
        elif candidate.policy_id in self._left:
            reason = "this policy was in force before and was rolled back; it does not come again"
            self._end(replace(report, decision=Decision.REFUSED, reason=reason), request)
        elif not request.activate:
            if self._keep is not None:
                self._keep(candidate, report)
            self._end(report, request)
        elif self._trainer.settings.shadow.ticks == 0:
            self._promote(candidate, incumbent, report, request)
        else:
            self._trial = _Trial(self._shadow(candidate, incumbent), report, request)

    def _shadow(self, candidate: Policy, incumbent: Policy) -> Shadow:
        latest = self._history.snapshot(last=1)
        since = int(latest.tick[-1]) + 1 if len(latest) else 0
        response = getattr(candidate, "response")  # noqa: B009 - the port does not promise one
        return Shadow(
            candidate,
            incumbent,
            response,
            self._trainer.settings.shadow,
            self._limits,
            since,
            self._clock.monotonic(),
        )

    def _try_candidate(self) -> None:
        """Let the candidate in shadow look at the new orbits, and decide about it."""
        trial = self._trial
        if trial is None:
            return
        shadow, now = trial.shadow, self._clock.monotonic()
        if self._slot.current is not shadow.incumbent:
            self._trial = None
            reason = "another policy was put in force while the candidate ran in shadow"
            refused = replace(trial.report, decision=Decision.REFUSED, reason=reason)
            self._end(replace(refused, stage=Stage.SHADOW), trial.request)
            return
        shadow.take(self._history.snapshot(since_tick=shadow.next_tick), now)
        verdict = shadow.verdict(now)
        if verdict is None:
            return
        self._trial = None
        figures = {**trial.report.figures, **verdict.figures}
        report = replace(trial.report, figures=figures, stage=Stage.SHADOW)
        if not verdict.accepted:
            refused = replace(report, decision=Decision.REFUSED, reason=verdict.reason)
            self._end(refused, trial.request)
            return
        report = replace(report, reason=f"{report.reason}; {verdict.reason}")
        self._promote(shadow.candidate, shadow.incumbent, report, trial.request)

    def _promote(
        self, candidate: Policy, incumbent: Policy, report: RefitReport, request: _Request
    ) -> None:
        before = observed_rms(self._history.snapshot(last=BASELINE))
        report = replace(report, decision=Decision.PROMOTED)
        if self._keep is not None:
            self._keep(candidate, report)
        self._slot.swap(candidate)
        latest = self._history.snapshot(last=1)
        if before.size:
            since = int(latest.tick[-1]) + 2 if len(latest) else 0
            self._watch = Watch(
                candidate, incumbent, float(np.median(before)), since, self._tripped()
            )
        self._end(report, request)

    def _watch_swap(self) -> None:
        """Go back to the former policy when the orbit has become worse since the swap."""
        watch = self._watch
        if watch is None:
            return
        if self._slot.current is not watch.promoted:  # an operator chose another one meanwhile
            self._watch = None
            return
        settings = self._trainer.settings
        new = self._history.snapshot(since_tick=watch.next_tick)
        reason = watch.look(new, settings)
        if not reason and self._tripped() and not watch.tripped_before:
            reason = f"the loop tripped {watch.seen} ticks after the swap"
        if reason:
            self._roll_back(watch, reason)
        elif watch.seen >= settings.watch:
            self._watch = None

    def _roll_back(self, watch: Watch, reason: str) -> None:
        left = self._slot.swap(watch.former)
        self._watch = None
        self._left.add(left.policy_id)
        # What led here is no ground for another candidate at once.
        self._refitted = self._checked
        self._afresh = True
        report = RefitReport(
            number=self._next_number(),
            time=self._clock.wall(),
            trigger="watch",
            rows=0,
            decision=Decision.ROLLED_BACK,
            reason=reason,
            policy_id=left.policy_id,
            incumbent_id=watch.former.policy_id,
            figures={"watched_ticks": float(watch.seen), "rms_before": watch.before},
            duration=0.0,
            stage=Stage.WATCH,
        )
        if self._keep is not None:
            self._keep(watch.former, report)
        self._publish(report)

    def _fail(self, trigger: str, reason: str, request: _Request | None) -> None:
        """Report a refit that came to nothing."""
        incumbent = self._slot.current.policy_id
        self._end(
            RefitReport(
                number=self._next_number(),
                time=self._clock.wall(),
                trigger=trigger,
                rows=0,
                decision=Decision.REFUSED,
                reason=reason,
                policy_id=incumbent,
                incumbent_id=incumbent,
                figures={},
                duration=0.0,
            ),
            request,
        )

    def _end(self, report: RefitReport, request: _Request | None) -> None:
        """Publish what became of a refit, and tell whoever asked for it."""
        self._publish(report)
        if request is not None and request.future is not None:
            request.future.set_result(report)

    def _next_number(self) -> int:
        self._number += 1
        return self._number
