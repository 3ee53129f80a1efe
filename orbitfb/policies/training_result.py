"""What the training of a policy gives back, whichever way it was trained."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orbitfb.policies.network import NetworkPolicy


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """A trained policy and how it came about; all but the policy fits on a card.

    Args:
        policy: The policy.
        method: Which training made it: `supervised` or `trajectory`.
        settings: Its settings, as plain JSON values.
        seeds: Every seed that went in, by name.
        curve: The loss at every iteration [1].
        figures: What the training came to, by name, SI.
    """

    policy: NetworkPolicy
    method: str
    settings: Mapping[str, Any]
    seeds: Mapping[str, int]
    curve: tuple[float, ...]
    figures: Mapping[str, float]
