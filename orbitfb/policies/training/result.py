"""What the training of a policy gives back, whichever way it was trained."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.network import NetworkPolicy

Trained = TypeVar("Trained", NetworkPolicy, ModalPolicy)


@dataclass(frozen=True, slots=True)
class TrainingResult(Generic[Trained]):
    """A trained policy and how it came about; all but the policy fits on a card.

    Args:
        policy: The policy.
        method: Which training made it: `supervised`, `trajectory`, `fine-tune` or `structured`.
        settings: Its settings, as plain JSON values.
        seeds: Every seed that went in, by name.
        curve: The loss at every iteration [1].
        figures: What the training came to, by name, SI.
    """

    policy: Trained
    method: str
    settings: Mapping[str, Any]
    seeds: Mapping[str, int]
    curve: tuple[float, ...]
    figures: Mapping[str, float]
