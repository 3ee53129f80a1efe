"""The store: a shelf of policies, and which of them is in force.

    STORE/active.json                 stack of activations; the last one is in force
    STORE/failures.json               policies that failed in force, and how

Both are replaced by a rename: whoever reads sees the old or the new, also after a kill or a power
cut. The policies themselves are in `policies.shelf`.
"""

from collections.abc import Callable
from pathlib import Path

from orbitfb.core.errors import StoreError
from orbitfb.core.files.whole import remove_directory, sole_writer
from orbitfb.core.ports import Clock
from orbitfb.policies.failures import Cause, Failure, add_failure, read_failures
from orbitfb.policies.shelf import PolicyShelf
from orbitfb.policies.stability import is_unstable
from orbitfb.policies.store.activations import (
    Activation,
    By,
    Probation,
    back_from,
    chosen,
    newest,
    read_activations,
    with_probation,
    with_top,
    without,
    write_activations,
)
from orbitfb.policies.store.card import check_identifier


class PolicyStore(PolicyShelf):
    """Policies by name, and which of them is in force.

    Args:
        path: The directory; it is made when something is first saved.
        clock: Gives the time on the cards; by default the system's.
    """

    def __init__(self, path: Path, clock: Clock | None = None) -> None:
        super().__init__(path, clock)
        self._active = self.path / "active.json"
        self._failures = self.path / "failures.json"

    def active(self) -> str | None:
        """Name the policy in force; None when none was ever activated.

        Raises:
            StoreError: `active.json` is damaged.
        """
        stack = self.activations()
        return stack[-1].id if stack else None

    def chosen(self) -> str | None:
        """Name the policy that an operator put in force last; None when no operator did.

        Raises:
            StoreError: `active.json` is damaged.
        """
        theirs = chosen(self.activations())
        return theirs.id if theirs else None

    def activations(self) -> tuple[Activation, ...]:
        """Give the stack of activations, the one in force last.

        Raises:
            StoreError: `active.json` is damaged.
        """
        return read_activations(self._active)

    def failures(self) -> dict[str, Failure]:
        """Give the last failure of every policy that failed in force, by its id.

        Raises:
            StoreError: `failures.json` is damaged.
        """
        return read_failures(self._failures)

    def fault_of(self, identifier: str) -> str:
        """Say why a policy should not act; empty when nothing is known against it.

        Raises:
            StoreError: `failures.json` is damaged.
        """
        failure = self.failures().get(identifier)
        try:
            warning = self.card(identifier).warning or ""
            unstable = warning if is_unstable(warning) else ""
        except StoreError as error:
            unstable = str(error)
        return "; ".join(filter(None, (failure.words if failure else "", unstable)))

    def failed(self, identifier: str, cause: Cause, reason: str) -> None:
        """Put on record that a policy failed in force.

        Args:
            identifier: Which.
            cause: How.
            reason: What the loop or the learner said.

        Raises:
            StoreError: It cannot be written.
        """
        with sole_writer(self.path):
            self._note(identifier, cause, reason)

    def activate(self, identifier: str, by: By = "operator", before: float | None = None) -> None:
        """Put a policy in force; activating the active one only makes it the operator's choice.

        A service that puts one in force in the place of another has it on probation, until
        `set_probation` says that it has proved itself.

        Args:
            identifier: Which.
            by: Who does it.
            before: Observed orbit before, for the watch of a probation, rms [m].

        Raises:
            StoreError: It does not exist or is damaged; the active one stays.
        """
        former = self.active()
        on_trial = by == "service" and former is not None and former != identifier
        probation = Probation(former=former, before=before) if former and on_trial else None
        self._put_in_force(identifier, by, probation)

    def begin(self, identifier: str) -> None:
        """Let a service begin with a policy, which is not on probation.

        Args:
            identifier: Which.

        Raises:
            StoreError: It does not exist or is damaged; the active one stays.
        """
        self._put_in_force(identifier, "service", None)

    def probation(self) -> Probation | None:
        """Give the probation of the policy in force; None when it has proved itself.

        Raises:
            StoreError: `active.json` is damaged.
        """
        stack = self.activations()
        return stack[-1].probation if stack else None

    def set_probation(self, identifier: str, probation: Probation | None) -> None:
        """Put on record how the probation of a policy goes, if it is in force and on one.

        Args:
            identifier: The policy.
            probation: None: it has proved itself.

        Raises:
            StoreError: It cannot be written.
        """
        with sole_writer(self.path):
            stack = self.activations()
            if (after := with_probation(stack, identifier, probation)) != stack:
                write_activations(self._active, after)

    def previous(self, force: bool = False) -> str:
        """Name the policy that `rollback` would go back to.

        Args:
            force: Also one that failed, or that would run away.

        Raises:
            StoreError: There is none.
        """
        return self._way_back(force)[-1].id

    def rollback(self, force: bool = False) -> str:
        """Go back to the policy that was active before this one; again: one further.

        Policies that failed in force or would run away are passed over.

        Args:
            force: Go back to the one right before, whatever is known against it.

        Returns:
            The id of the policy now in force.

        Raises:
            StoreError: There is none before it, or it is damaged; the active one stays.
        """
        with sole_writer(self.path):
            stack = self._way_back(force)
            identifier = stack[-1].id
            self._check_whole(identifier)
            chosen_now = {"by": "operator", "probation": None}  # who goes back chooses it
            write_activations(self._active, (*stack[:-1], stack[-1].model_copy(update=chosen_now)))
            self._adopt(identifier)
            return identifier

    def withdraw(self, identifier: str, restored: str, reason: str = "") -> None:
        """Take a policy out of force for good: going back does not lead to it again.

        It stays in the store and can still be activated by name.

        Args:
            identifier: The policy that failed, or that nobody could watch.
            restored: The one that is in force instead.
            reason: How it failed, to be put on record; empty: that is not known.

        Raises:
            StoreError: The one restored does not exist or is damaged; nothing is changed.
        """
        with sole_writer(self.path):
            self._check_whole(restored)
            left = without(self.activations(), identifier, restored, self._clock.wall())
            write_activations(self._active, left)
            if reason:
                self._note(identifier, "rolled_back", reason)

    def prune(self, keep: int, removed: Callable[[str], None] = lambda _: None) -> list[str]:
        """Remove old policies of the learner that are not among those last in force.

        Args:
            keep: How many of the learner's newest, and of those last in force, stay.
            removed: Told of each one when it is gone, also if a later one cannot be removed.

        Returns:
            The ids that were removed.

        Raises:
            StoreError: A directory cannot be removed.
        """
        with sole_writer(self.path):
            stack = self.activations()
            staying = {activation.id for activation in newest(stack, keep)}
            staying |= {entry.probation.former for entry in stack if entry.probation}
            cards = self.cards(lambda _: None)  # a damaged one stays, to be looked at
            learnt = [card.id for card in cards if card.owner == "learner"]
            leaving = [identifier for identifier in learnt[:-keep] if identifier not in staying]
            if leaving:
                # First, so that no activation names what is gone.
                left = [entry for entry in stack if entry.id not in leaving]
                write_activations(self._active, left)
            for identifier in leaving:
                try:
                    remove_directory(self.path / identifier)
                except OSError as error:
                    raise StoreError(
                        f"{self.path / identifier} cannot be removed ({error.strerror}); repair "
                        "the permissions"
                    ) from error
                removed(identifier)
        return leaving

    def _put_in_force(self, identifier: str, by: By, probation: Probation | None) -> None:
        with sole_writer(self.path):
            self._check_whole(identifier)
            new = Activation(id=identifier, time=self._clock.wall(), by=by, probation=probation)
            stack = self.activations()
            if (after := with_top(stack, new)) != stack:
                write_activations(self._active, after)
            if by == "operator":
                self._adopt(identifier)

    def _way_back(self, force: bool) -> tuple[Activation, ...]:
        stack, passed = back_from(self.activations(), (lambda _: "") if force else self.fault_of)
        if stack:
            return stack
        advice = "activate one by name instead: `orbitfb policies activate ID`"
        if passed:
            told = "; ".join(f"{identifier} {fault}" for identifier, fault in passed.items())
            raise StoreError(
                f"no policy that was active before in {self.path} may be gone back to: {told}; "
                f"{advice}, or insist with `orbitfb policies rollback --force`"
            )
        raise StoreError(f"no policy was active before the present one in {self.path}; {advice}")

    def _note(self, identifier: str, cause: Cause, reason: str) -> None:
        failure = Failure(
            id=check_identifier(identifier), time=self._clock.wall(), cause=cause, reason=reason
        )
        add_failure(self._failures, failure)
