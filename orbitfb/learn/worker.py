"""The learner's thread: when to refit, what to do with the verdict, when to take it back."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.transitions import Transitions
from orbitfb.learn.learner import Learner

_POLL = 0.2
_BASELINE = 100


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


Publish = Callable[[RefitReport], None]
Keep = Callable[[Policy, RefitReport], None]


@dataclass(slots=True)
class _Watch:
    """A swap under observation."""

    promoted: Policy
    former: Policy
    before: float
    since_tick: int
    bad: int = 0


class LearnerThread(threading.Thread):
    """Refits beside the loop and swaps its policy.

    Everything happens in `step`, which a test may call without starting the thread.

    Args:
        learner: Identification and judgement.
        history: The last transitions.
        slot: The policy in force.
        publish: Gets every report, in this thread; it must not raise.
        keep: Stores a policy that was accepted or promoted with its report, before it is put in
            force; for a roll-back, the policy restored; None: nothing is stored.
        poll: How often to look for new ticks [s].
    """

    def __init__(
        self,
        learner: Learner,
        history: TransitionSource,
        slot: Slot,
        publish: Publish,
        keep: Keep | None = None,
        poll: float = _POLL,
    ) -> None:
        super().__init__(name="learner", daemon=True)
        self._learner, self._history, self._slot = learner, history, slot
        self._publish, self._keep, self._poll = publish, keep, poll
        self._wake = threading.Event()
        self._stopping = False
        self._requests: list[tuple[Future[RefitReport], bool]] = []
        self._lock = threading.Lock()
        self._checked: int | None = None
        self._refitted: int | None = None
        self._watch: _Watch | None = None

    def request(self, activate: bool = True) -> Future[RefitReport]:
        """Ask for a refit now.

        Args:
            activate: Whether an accepted candidate is put in force, or only kept.

        Returns:
            The report, when it is there.
        """
        future: Future[RefitReport] = Future()
        with self._lock:
            self._requests.append((future, activate))
        self._wake.set()
        return future

    def stop(self, timeout: float = 1.0) -> None:
        """Let the thread end; requests that wait are cancelled."""
        self._stopping = True
        self._wake.set()
        if self.is_alive():
            self.join(timeout)
        with self._lock:
            requests, self._requests = self._requests, []
        for future, _ in requests:
            future.cancel()

    def run(self) -> None:
        """Look for work until stopped."""
        while not self._stopping:
            self.step()
            self._wake.wait(self._poll)
            self._wake.clear()

    def step(self) -> None:
        """Do what is due now: watch the last swap, answer requests, look at the innovations."""
        with self._lock:
            requests, self._requests = self._requests, []
        try:
            self._look()
        except Exception as error:  # the outermost guard of the thread: reported, never lost
            self._report_failure("periodic", error)
        for future, activate in requests:
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(self._refit("on-demand", activate))
                except Exception as error:
                    future.set_result(self._report_failure("on-demand", error))

    def _look(self) -> None:
        settings = self._learner.settings
        new = self._history.snapshot(since_tick=self._next_tick())
        if len(new) == 0:
            return
        newest = int(new.tick[-1])
        if self._checked is None:
            self._checked = self._refitted = int(new.tick[0]) - 1
        if newest - self._checked < settings.check:
            return
        self._checked = newest
        rolled_back = self._watch_swap()
        absorbed = self._learner.absorb(new, self._slot.current)
        if rolled_back:  # what led here is no ground for another candidate at once
            self._refitted = newest
            return
        surprised = absorbed.rows > 0 and absorbed.chi2_other > settings.chi2_trigger
        due = self._refitted is None or newest - self._refitted >= settings.every
        if settings.enabled and (due or surprised):
            self._refit("periodic" if due else "innovation", activate=True)

    def _next_tick(self) -> int | None:
        last = self._learner.last_tick
        return None if last is None else last + 1

    def _refit(self, trigger: str, activate: bool) -> RefitReport:
        incumbent = self._slot.current
        new = self._history.snapshot(since_tick=self._next_tick())
        newest = int(new.tick[-1]) if len(new) else self._learner.last_tick
        self._refitted = self._refitted if newest is None else newest
        report, candidate = self._learner.refit(new, incumbent, trigger)
        if report.decision is Decision.ACCEPTED and candidate is not None:
            if activate:
                report = replace(report, decision=Decision.PROMOTED)
                self._promote(candidate, incumbent, report)
            elif self._keep is not None:
                self._keep(candidate, report)
        self._publish(report)
        return report

    def _promote(self, candidate: Policy, incumbent: Policy, report: RefitReport) -> None:
        before = self._observed_rms(self._history.snapshot(last=_BASELINE))
        if self._keep is not None:
            self._keep(candidate, report)
        self._slot.swap(candidate)
        newest = self._learner.last_tick or 0
        if before.size:
            self._watch = _Watch(candidate, incumbent, float(np.median(before)), newest + 2)

    def _watch_swap(self) -> bool:
        """Go back to the former policy when the orbit has become worse since the swap."""
        watch, settings = self._watch, self._learner.settings
        if watch is None:
            return False
        if self._slot.current is not watch.promoted:  # an operator chose another one meanwhile
            self._watch = None
            return False
        rms = self._observed_rms(self._history.snapshot(since_tick=watch.since_tick))
        limit = settings.rollback_factor * watch.before
        bad = 0
        for value in rms[: settings.watch]:
            bad = bad + 1 if value > limit else 0
            if bad >= settings.rollback_ticks:
                self._roll_back(watch, limit)
                return True
        if rms.size >= settings.watch:
            self._watch = None
        return False

    def _roll_back(self, watch: _Watch, limit: float) -> None:
        left = self._slot.swap(watch.former)
        self._watch = None
        report = self._learner.rolled_back(
            left,
            watch.former,
            f"after the swap the observed orbit stayed above {limit * 1e6:.3g} µm rms "
            f"({self._learner.settings.rollback_factor:.1f} x what it was) for "
            f"{self._learner.settings.rollback_ticks} ticks",
        )
        if self._keep is not None:
            self._keep(watch.former, report)
        self._publish(report)

    @staticmethod
    def _observed_rms(transitions: Transitions) -> np.ndarray:
        """Rms of the orbit error of every closed tick, shape (T,) [m]."""
        closed = transitions.closed & transitions.valid.any(axis=1)
        error = (transitions.orbit - transitions.reference)[closed]
        valid = transitions.valid[closed]
        squares = np.where(valid, error, 0.0) ** 2
        return np.sqrt(squares.sum(axis=1) / np.maximum(valid.sum(axis=1), 1))

    def _report_failure(self, trigger: str, error: Exception) -> RefitReport:
        known = isinstance(error, OrbitFeedbackError)
        reason = str(error) if known else f"the refit failed: {error!r}"
        report = self._learner.failed(trigger, self._slot.current, reason)
        self._publish(report)
        return report
