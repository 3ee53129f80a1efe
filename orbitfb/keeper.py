"""Which stored policy runs first, and what becomes of those that the learner makes."""

from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import Channels, Mask
from orbitfb.learn.builders import ResponsePolicy, masked
from orbitfb.policies.kinds import kind_of
from orbitfb.policies.store import PolicyStore


class Keeper:
    """Keeps the store in step with the policy in force.

    Args:
        store: The policy store.
        channels: Of the loop.
        kept: How many policies stay in the store.

    Attributes:
        reason: Why the first policy is the one it is; empty before there is one.
    """

    def __init__(self, store: PolicyStore, channels: Channels, kept: int) -> None:
        self._store, self._channels, self._kept = store, channels, kept
        self.reason = ""

    def first(
        self, nominal: ResponsePolicy, movable: Mask, new_ring: bool, asked: bool = False
    ) -> ResponsePolicy:
        """Take up a stored policy, or begin with the one that the configuration makes.

        A ring that goes on has the policy that was in force, whoever put it there. A simulated
        ring of our own is new: what an earlier service identified is not about it, but what an
        operator put in force is taken up, unless another kind is asked for.

        Args:
            nominal: The policy of the configuration.
            movable: Correctors that may move, shape (m,).
            new_ring: Whether the ring is new.
            asked: Whether the kind of `nominal` was asked for at this start.

        Raises:
            StoreError: The policy to take up is missing, damaged, or of another ring.
        """
        active = self._store.active()
        stored = self._store.chosen() if new_ring else active
        if stored is None:
            self.reason = "that of the configuration"
            if active not in (None, nominal.policy_id):
                self.reason += (
                    f"; {active} was put in force by a service, for a ring that is no more: "
                    f"`orbitfb policies activate {active}` puts it in force here"
                )
            return self._begin(nominal)
        policy = self._store.load(stored, self._channels)
        other = asked and kind_of(policy)[0] is not kind_of(nominal)[0]
        if other and new_ring:
            self.reason = (
                f"of the kind that --policy asks for; {stored}, which was activated, is of another "
                "kind: leave out --policy to run it"
            )
            return self._begin(nominal)
        self.reason = "as it was activated" if new_ring else "as it was in force before"
        if other:
            self.reason += (
                f"; --policy asks for another kind, as {nominal.policy_id} is: put one in force "
                "with `orbitfb train KIND --activate`"
            )
        self._store.activate(stored, by="service")
        return masked(policy, movable)

    def _begin(self, nominal: ResponsePolicy) -> ResponsePolicy:
        self._store.save(nominal, self._channels)
        self._store.activate(nominal.policy_id, by="service")
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
            self._store.activate(policy.policy_id, by="service")
        self._store.prune(self._kept)
