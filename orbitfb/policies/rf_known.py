"""What a policy knows of the RF: the column that was identified together with its response.

It goes with the policy into the store, to the trainer's process and into force, whatever its kind,
and with a policy that is wrapped. One that knows nothing leaves the column to the places table.
"""

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.ports import Policy
from orbitfb.estimation.columns import KnownRf
from orbitfb.policies.masking import MaskedPolicy

PolicyType = TypeVar("PolicyType", bound=Policy)

COLUMN, ENERGY = "rf_column", "rf_energy"
"""Tensors of the store."""


def rf_of(policy: Any) -> KnownRf | None:
    """Give what a policy knows of the RF; None: nothing."""
    return getattr(policy, "rf", None)


def with_rf(policy: PolicyType, rf: KnownRf | None) -> PolicyType:
    """Let a policy know the RF.

    Args:
        policy: It is changed.
        rf: What is known; None: it is left as it is.
    """
    if rf is not None:
        _inside(policy).rf = rf
    return policy


def told(policy: PolicyType, rf: KnownRf | None) -> PolicyType:
    """Tell a policy what the places table says of the RF, unless it knows better."""
    return with_rf(policy, rf) if rf_of(policy) is None else policy


def _inside(policy: Any) -> Any:
    while isinstance(policy, MaskedPolicy):
        policy = policy.policy
    return policy


def rf_tensors(policy: Policy) -> dict[str, NDArray[Any]]:
    """Give what the store keeps: only a column that was identified."""
    rf = rf_of(policy)
    if rf is None or not rf.identified:
        return {}
    return {
        COLUMN: np.ascontiguousarray(rf.response),
        ENERGY: np.ascontiguousarray(rf.energy),
    }


def rf_from(tensors: Mapping[str, NDArray[Any]]) -> KnownRf | None:
    """Read it back; None: nothing was kept."""
    if COLUMN not in tensors:
        return None
    return KnownRf(tensors[COLUMN], tensors[ENERGY], identified=True)
