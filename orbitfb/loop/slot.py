"""The place from which the loop takes its policy, between two ticks."""

import threading

from orbitfb.core.ports import Policy


class PolicySlot:
    """Holds the policy in force; any thread may swap it.

    The runner takes the new policy between two ticks and begins with its initial state. The
    setpoints are absolute and stay where they are, so that nothing jumps.

    Args:
        policy: The policy to begin with.
    """

    def __init__(self, policy: Policy) -> None:
        self._lock = threading.Lock()
        self._policy = policy
        self._swaps = 0

    @property
    def current(self) -> Policy:
        """The policy that the next tick decides with."""
        with self._lock:
            return self._policy

    @property
    def swaps(self) -> int:
        """Count of swaps since the start."""
        with self._lock:
            return self._swaps

    def swap(self, policy: Policy) -> Policy:
        """Put another policy in force and return the one that was."""
        with self._lock:
            before, self._policy = self._policy, policy
            self._swaps += 1
            return before
