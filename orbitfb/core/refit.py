"""What one refit of the model came to: the word that learner, store, metrics and log share."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Decision(StrEnum):
    """What became of a candidate policy."""

    PROMOTED = "promoted"
    """The judge accepted it and it was put in force."""
    ACCEPTED = "accepted"
    """The judge accepted it; nobody asked to put it in force."""
    REFUSED = "refused"
    """The judge refused it."""
    ROLLED_BACK = "rolled_back"
    """It was in force, and made the loop worse."""


class Stage(StrEnum):
    """How far a candidate came."""

    JUDGE = "judge"
    """Judged on data and model, before it saw a live orbit."""
    SHADOW = "shadow"
    """Asked beside the incumbent on live orbits, without acting."""
    WATCH = "watch"
    """In force, and watched."""


class AlarmCause(StrEnum):
    """What shows that the incumbent's response is not the ring's any more."""

    SURPRISE = "surprise"
    """The innovations are far larger than noise and ground explain."""
    DRIFT = "drift"
    """The innovations follow the corrections; tested at a stated rate of false alarms."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """The running model no longer explains the orbits.

    Args:
        tick: When it was seen.
        cause: What shows it.
        delay: Ticks from the change, as far as the statistic can tell, to the alarm [ticks].
        statistic: What passed its threshold [1].
        threshold: The threshold [1].
    """

    tick: int
    cause: AlarmCause
    delay: float
    statistic: float
    threshold: float


@dataclass(frozen=True, slots=True)
class RefitReport:
    """One refit, judged.

    Args:
        number: Count of refits since the start, from 1.
        time: When it ended [s since the epoch].
        trigger: Why it was made: `periodic`, `on-demand`, `degradation` (the innovations say that
            the incumbent's response is not the ring's any more) or `watch` (a roll-back).
        rows: Transitions that went in.
        decision: What became of the candidate.
        reason: Why, in one sentence with figures.
        policy_id: The candidate (for a roll-back: the policy that was left).
        incumbent_id: The policy that it was judged against (for a roll-back: the one restored).
        figures: Judged figures by name, SI; the names are documented in the metrics page.
        duration: How long the refit took [s].
        stage: Where it was decided.
    """

    number: int
    time: float
    trigger: str
    rows: int
    decision: Decision
    reason: str
    policy_id: str
    incumbent_id: str
    figures: Mapping[str, float]
    duration: float
    stage: Stage = Stage.JUDGE
