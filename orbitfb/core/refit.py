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


@dataclass(frozen=True, slots=True)
class RefitReport:
    """One refit, judged.

    Args:
        number: Count of refits since the start, from 1.
        time: When it ended [s since the epoch].
        trigger: Why it was made: `periodic`, `on-demand`, `innovation` or `watch` (a roll-back).
        rows: Transitions that went in.
        decision: What became of the candidate.
        reason: Why, in one sentence with figures.
        policy_id: The candidate (for a roll-back: the policy that was left).
        incumbent_id: The policy that it was judged against (for a roll-back: the one restored).
        figures: Judged figures by name, SI; the names are documented in the metrics page.
        duration: How long the refit took [s].
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
