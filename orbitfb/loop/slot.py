"""The place from which the loop takes its policy, between two ticks."""

import threading
from collections.abc import Callable

from orbitfb.core.ports import Policy


class PolicySlot:
    """Holds the policy in force; any thread may swap it.

    The runner takes the new policy between two ticks and begins with its initial state. The
    setpoints are absolute and stay where they are, so that nothing jumps.

    Args:
        policy: The policy to begin with.
        dress: Makes of a policy the one that acts; see `redress`.
    """

    def __init__(
        self, policy: Policy, dress: Callable[[Policy], Policy] = lambda policy: policy
    ) -> None:
        self._lock = threading.Lock()
        self._policy, self._dress = policy, dress
        self._acting = dress(policy)
        self._swaps = 0
        self.prepare: Callable[[Policy], None] = lambda policy: None
        """Told of a policy that is about to be swapped in, in the thread that swaps."""

    @property
    def current(self) -> Policy:
        """The policy in force, as it was swapped in."""
        with self._lock:
            return self._policy

    @property
    def acting(self) -> Policy:
        """The policy that the next tick decides with: the same, dressed."""
        with self._lock:
            return self._acting

    @property
    def swaps(self) -> int:
        """Count of swaps since the start."""
        with self._lock:
            return self._swaps

    def swap(self, policy: Policy) -> Policy:
        """Put another policy in force and return the one that was."""
        while not self.swap_from(before := self.current, policy):
            pass
        return before

    def swap_from(self, expected: Policy, policy: Policy) -> bool:
        """Put a policy in force in place of an expected one; say whether that one was in force.

        Whoever has thought about it for a while must not undo what an operator chose meanwhile.
        """
        while True:
            dress = self._dress
            dressed = dress(policy)  # not under the lock: a tick must not wait for it
            self.prepare(dressed)
            with self._lock:
                if self._policy is not expected:
                    return False
                if dress is self._dress:
                    self._policy, self._acting = policy, dressed
                    self._swaps += 1
                    return True

    def redress(self, dress: Callable[[Policy], Policy]) -> None:
        """Let every policy act otherwise from now on, such as without some correctors.

        Args:
            dress: Makes of a policy the one that acts.
        """
        while True:
            policy = self.current
            acting = dress(policy)
            with self._lock:
                if policy is self._policy:
                    self._dress, self._acting = dress, acting
                    return
