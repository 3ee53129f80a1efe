"""Which stored policy runs first, and what becomes of those that the learner makes."""

from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import Channels, Mask
from orbitfb.learn.builders import ResponsePolicy, masked
from orbitfb.policies.store import PolicyStore


class Keeper:
    """Keeps the store in step with the policy in force.

    Args:
        store: The policy store.
        channels: Of the loop.
        kept: How many policies stay in the store.
    """

    def __init__(self, store: PolicyStore, channels: Channels, kept: int) -> None:
        self._store, self._channels, self._kept = store, channels, kept

    def first(self, nominal: ResponsePolicy, movable: Mask, new_ring: bool) -> ResponsePolicy:
        """Take up the stored policy; a simulated ring of our own is new and gets the baseline.

        Args:
            nominal: The baseline.
            movable: Correctors that may move, shape (m,).
            new_ring: Whether nothing stored can be about this ring.
        """
        active = self._store.active()
        if not new_ring and active is not None:
            return masked(self._store.load(active, self._channels), movable)
        self._store.save(nominal, self._channels)
        self._store.activate(nominal.policy_id)
        return nominal

    def keep(self, policy: Policy, report: RefitReport) -> None:
        """Store a policy that the judge accepted; activate one that goes in or back in force.

        Args:
            policy: The candidate, or the policy that is back in force.
            report: What became of it.
        """
        if report.decision is Decision.ROLLED_BACK:
            self._store.withdraw(report.policy_id, policy.policy_id)
        else:
            self._store.save(
                policy, self._channels, parent=report.incumbent_id, figures=report.figures
            )
        if report.decision is Decision.PROMOTED:
            self._store.activate(policy.policy_id)
        self._store.prune(self._kept)
