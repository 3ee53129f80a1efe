"""What the learner's thread asks of whoever does the arithmetic, here or in another process."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.ports import Policy
from orbitfb.core.refit import Alarm, RefitReport
from orbitfb.core.transitions import Transitions
from orbitfb.learn.settings import LearnSettings

if TYPE_CHECKING:
    from orbitfb.learn.learner import Learner

MOST_ROWS = 2000
"""Rows of one task; more would be of an older ring, and take long to copy and to send."""


@dataclass(frozen=True, slots=True)
class Task:
    """One piece of work.

    Args:
        transitions: What is new.
        incumbent: The policy in force.
        trigger: Why a refit is asked for; None: take the rows in, and refit only when they say
            that the incumbent has degraded.
        may_refit: Whether they may say so.
        afresh: Give up R̂, which a swap that was rolled back was made of.
    """

    transitions: Transitions
    incumbent: Policy
    trigger: str | None = None
    may_refit: bool = True
    afresh: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """What a task came to.

    Args:
        trigger: Why a refit was made or tried; None: none was.
        report: Of the refit.
        candidate: What it built.
        failure: Why it came to nothing; empty when it did not.
        alarm: A degradation, when it was first seen.
    """

    trigger: str | None = None
    report: RefitReport | None = None
    candidate: Policy | None = None
    failure: str = ""
    alarm: Alarm | None = None


class Trainer(Protocol):
    """Takes one task at a time and answers it, at once or later; it never makes one wait."""

    @property
    def settings(self) -> LearnSettings:
        """How to identify, judge and watch."""
        ...

    @property
    def last_tick(self) -> int | None:
        """Tick of the last row that was handed over; None before the first."""
        ...

    @property
    def ready(self) -> bool:
        """Whether a task may be submitted now."""
        ...

    def submit(self, task: Task) -> None:
        """Begin a task."""
        ...

    def collect(self) -> Answer | None:
        """Give the answer to the last task once; None while there is none."""
        ...

    def close(self) -> None:
        """Let go of what is held."""
        ...


class InlineTrainer:
    """Answers at once, in the thread that asks.

    Args:
        learner: Does the work.
    """

    def __init__(self, learner: "Learner") -> None:
        self.learner = learner
        self._answer: Answer | None = None

    @property
    def settings(self) -> LearnSettings:
        """How to identify, judge and watch."""
        return self.learner.settings

    @property
    def last_tick(self) -> int | None:
        """Tick of the last row that taught; None before the first."""
        return self.learner.last_tick

    @property
    def ready(self) -> bool:
        """Always."""
        return True

    def submit(self, task: Task) -> None:
        """Do the task."""
        self._answer = work(self.learner, task)

    def collect(self) -> Answer | None:
        """Give the answer."""
        answer, self._answer = self._answer, None
        return answer

    def close(self) -> None:
        """Nothing is held."""


def work(learner: "Learner", task: Task) -> Answer:
    """Do a task; whatever goes wrong is in the answer.

    Args:
        learner: Keeps the estimate.
        task: What to do.
    """
    trigger = task.trigger
    try:
        if task.afresh:
            learner.forget(task.incumbent)
        learner.absorb(task.transitions, task.incumbent)
        alarm = learner.take_alarm()
        if trigger is None and task.may_refit and learner.degraded:
            trigger = "degradation"
        if trigger is None:
            return Answer(alarm=alarm)
        report, candidate = learner.conclude(task.incumbent, trigger)
        return Answer(trigger, report, candidate, alarm=alarm)
    except Exception as error:  # reported to whoever asked, never lost
        return Answer(trigger or "periodic", failure=explain(error))


def explain(error: Exception) -> str:
    """Say what went wrong: a known error in its own words, any other one by its name."""
    return str(error) if isinstance(error, OrbitFeedbackError) else f"the refit failed: {error!r}"
