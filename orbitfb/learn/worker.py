"""The learner's thread: when to refit, what to do with the verdict, when to take it back.

    snapshot ─► trainer: refit, improve, judge ─► shadow ─► promote ─► watch ─► roll back

The arithmetic is the trainer's, here or in a process of its own. This thread never waits for it,
so that a swap is watched whatever the trainer does.
"""

import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, replace

from orbitfb.core.clock import SystemClock
from orbitfb.core.ports import Clock, Policy
from orbitfb.core.refit import Alarm, Decision, RefitReport
from orbitfb.core.transitions import Transitions
from orbitfb.learn.succession import (
    Keep,
    NoRecords,
    Records,
    Slot,
    Succession,
    TransitionSource,
)
from orbitfb.learn.trainer import MOST_ROWS, Answer, Task, Trainer, explain
from orbitfb.learn.watch import prepare_watch
from orbitfb.safety.limits import LimitSettings

_POLL = 0.2

Publish = Callable[[RefitReport], None]


@dataclass(frozen=True, slots=True)
class _Request:
    """Somebody asks for a refit; `future` is None when it is the thread itself."""

    future: Future[RefitReport] | None
    activate: bool


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
        records: What is known of policies beyond the life of this program.
        teaching: The transitions that may teach; None: those of the history.
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
        records: Records | None = None,
        teaching: TransitionSource | None = None,
    ) -> None:
        super().__init__(name="learner", daemon=True)
        prepare_watch()
        self._trainer, self._slot = trainer, slot
        self._teaching = history if teaching is None else teaching
        self._publish, self._poll, self._alarmed = publish, poll, alarmed
        self._keep = keep or _keep_nothing
        self._clock = clock or SystemClock()
        self._succession = Succession(
            trainer.settings,
            history,
            slot,
            self._keep,
            limits or LimitSettings(),
            tripped,
            self._clock,
            records or NoRecords(),
        )
        self._wake = threading.Event()
        self._stopping = False
        self._requests: list[_Request] = []
        self._lock = threading.Lock()
        self._number = 0
        self._checked: int | None = None
        self._refitted: int | None = None
        self._afresh = False
        self._asked: tuple[_Request, Policy] | None = None
        self._running: set[Future[RefitReport]] = set()

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

    def resume(self, former: Policy, before: float | None, seen: int) -> None:
        """Go on watching the policy in force, which an earlier service promoted.

        Args:
            former: The policy to go back to.
            before: Observed orbit before the swap, rms [m]; None: not known.
            seen: Ticks for which it was watched [ticks].
        """
        self._succession.resume(former, before, seen)

    def stop(self, timeout: float = 1.0) -> None:
        """Let the thread end and the trainer go; requests that wait are cancelled."""
        self._stopping = True
        self._wake.set()
        if self.is_alive():
            self.join(timeout)
        self._trainer.close()
        with self._lock:
            requests, self._requests = self._requests, []
        self._succession.end()
        waiting = {request.future for request in requests if request.future} | self._running
        for future in waiting:
            if not future.cancel() and not future.done():
                future.set_exception(CancelledError())

    def run(self) -> None:
        """Look for work until stopped."""
        while not self._stopping:
            self.step()
            self._wake.wait(self._poll)
            self._wake.clear()

    def step(self) -> None:
        """Do what is due now; nothing here takes long unless the trainer is in this thread."""
        for part in (self._collect, self._watch_swap, self._succession.try_candidate, self._ask):
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
        if last is None:
            new = self._teaching.snapshot(last=MOST_ROWS)
        else:
            new = self._teaching.snapshot(since_tick=last + 1)
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
            while self._requests and not self._succession.trying:
                request = self._requests.pop(0)
                if request.future is None:
                    return request
                if request.future.set_running_or_notify_cancel():
                    self._running.add(request.future)
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
        free = settings.enabled and not self._succession.trying
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
        elif request.activate:
            self._succession.begin(
                candidate, incumbent, report, lambda told: self._end(told, request)
            )
        else:
            self._keep(candidate, report)
            self._end(report, request)

    def _watch_swap(self) -> None:
        """Look at the last swap; after a roll-back, begin anew."""
        report = self._succession.watch_swap()
        if report is None:
            return
        self._refitted = self._checked  # what led here is no ground for another candidate at once
        self._afresh = True
        self._publish(replace(report, number=self._next_number()))

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
            self._running.discard(request.future)
            if not request.future.done():
                request.future.set_result(report)

    def _next_number(self) -> int:
        self._number += 1
        return self._number


def _keep_nothing(policy: Policy, report: RefitReport) -> None:
    """Store nothing."""
