"""Which stored policy runs first, and what becomes of those that the learner makes."""

from dataclasses import dataclass

import structlog

from orbitfb.core.errors import StoreError
from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision, RefitReport, Stage
from orbitfb.core.signals import Channels, Mask
from orbitfb.learn.builders import ResponsePolicy, masked
from orbitfb.policies.store.activations import Probation
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.store.kinds import kind_of

_log = structlog.stdlib.get_logger("orbitfb.service")


@dataclass(frozen=True, slots=True)
class Resumed:
    """A probation that goes on.

    Args:
        former: The policy to go back to.
        probation: How far it is.
    """

    former: ResponsePolicy
    probation: Probation


class Keeper:
    """Keeps the store in step with the policy in force.

    Args:
        store: The policy store.
        channels: Of the loop.
        kept: How many of the learner's policies stay in the store.
        watches: Whether the learner runs, which alone can watch a policy on probation.

    Attributes:
        reason: Why the first policy is the one it is; empty before there is one.
        resumed: The probation of the first policy; None when it is on none.
    """

    def __init__(
        self, store: PolicyStore, channels: Channels, kept: int, watches: bool = True
    ) -> None:
        self._store, self._channels, self._kept = store, channels, kept
        self._watches = watches
        self.reason = ""
        self.resumed: Resumed | None = None

    def first(
        self, nominal: ResponsePolicy, movable: Mask, new_ring: bool, asked: bool = False
    ) -> ResponsePolicy:
        """Take up a stored policy, or begin with the one that the configuration makes.

        A ring that goes on has the policy that was in force, whoever put it there; one on
        probation only if its watch was suspended in good order, else the one before it. A
        simulated ring of our own is new: what an earlier service identified is not about it, but
        what an operator put in force is taken up, unless another kind is asked for.

        Args:
            nominal: The policy of the configuration.
            movable: Correctors that may move, shape (m,).
            new_ring: Whether the ring is new.
            asked: Whether the kind of `nominal` was asked for at this start.

        Raises:
            StoreError: The policy to take up is missing, damaged, or of another ring.
        """
        taken_back = "" if new_ring else self._settle(movable)
        active = self._store.active()
        stored = self._store.chosen() if new_ring else active
        if stored is None:
            self.reason = "the configured policy"
            if active not in (None, nominal.policy_id):
                self.reason += (
                    f"; {active} was in force on an earlier simulated ring: `orbitfb policies "
                    f"activate {active}` puts it in force here"
                )
            return self._begin(nominal)
        policy = self._store.load(stored, self._channels)
        other = asked and kind_of(policy)[0] is not kind_of(nominal)[0]
        if other and new_ring:
            self.reason = (
                f"the kind that --policy asks for; {stored} was activated and is of another kind: "
                "leave out --policy to run it"
            )
            return self._begin(nominal)
        self.reason = "the activated policy" if new_ring else "the policy that was in force before"
        self.reason += taken_back
        if other:
            self.reason += (
                f"; --policy asks for another kind, that of {nominal.policy_id}: put one in force "
                "with `orbitfb train KIND --activate`"
            )
        self._store.begin(stored)
        return masked(policy, movable)

    def _settle(self, movable: Mask) -> str:
        """Go on with the probation of the policy in force, or take it back; say if it was."""
        active, probation = self._store.active(), self._store.probation()
        if active is None or probation is None:
            return ""
        former = masked(self._store.load(probation.former, self._channels), movable)
        if probation.suspended and self._watches:
            self.resumed = Resumed(former, probation)
            self._store.set_probation(active, probation.model_copy(update={"suspended": False}))
            return ""
        self._store.withdraw(active, probation.former)
        why = (
            "the learner, which would watch it, is off"
            if probation.suspended
            else "the service before this one was killed"
        )
        told = f"{active} was on probation and {why}: the policy before it is in force again"
        _log.warning("probation_taken_back", policy=active, restored=probation.former, problem=why)
        return f"; {told}"

    def _begin(self, nominal: ResponsePolicy) -> ResponsePolicy:
        self._store.save(nominal, self._channels)
        self._store.begin(nominal.policy_id)
        return nominal

    def keep(self, policy: Policy, report: RefitReport) -> None:
        """Store a policy that the judge accepted; activate one that goes in or back in force.

        Args:
            policy: The candidate, or the policy that is back in force.
            report: What became of it.
        """
        promoted = report.decision is Decision.PROMOTED
        if report.decision is Decision.ROLLED_BACK:
            # Else somebody put another one in force while this one was stored: it did not fail.
            failed = report.reason if report.stage is Stage.WATCH else ""
            self._store.withdraw(report.policy_id, policy.policy_id, failed)
        else:
            self._store.save(
                policy,
                self._channels,
                parent=report.incumbent_id,
                figures=report.figures,
                owner="learner" if promoted else "operator",
            )
        if promoted:
            before = report.figures.get("rms_before")
            self._store.activate(policy.policy_id, by="service", before=before)
        self._store.prune(self._kept, self._tell_removed)

    def _tell_removed(self, identifier: str) -> None:
        _log.info("policy_removed", policy=identifier, kept=self._kept)

    def proved(self, identifier: str) -> None:
        """Put on record that a promoted policy passed its watch."""
        self._note(identifier, None)

    def suspended(self, identifier: str, seen: int) -> None:
        """Leave the watch over a promoted policy to the next service.

        Args:
            identifier: The policy.
            seen: Ticks for which it was watched [ticks].
        """
        now = self._store.probation()
        if now is not None:
            self._note(identifier, now.model_copy(update={"seen": seen, "suspended": True}))

    def fault_of(self, identifier: str) -> str:
        """Say how a policy failed in force; empty when nothing is known against it."""
        try:
            failure = self._store.failures().get(identifier)
        except StoreError as error:  # who cannot tell does not promote
            return str(error)
        return failure.words if failure else ""

    def _note(self, identifier: str, probation: Probation | None) -> None:
        try:
            self._store.set_probation(identifier, probation)
        except StoreError as error:  # it begins anew, or is taken back, at the next start
            _log.warning("probation_not_saved", policy=identifier, problem=str(error))
