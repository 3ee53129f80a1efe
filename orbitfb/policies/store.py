"""A directory of policies: tensors in safetensors, a JSON card beside them, one of them active.

    STORE/<id>/policy.safetensors     response matrix, weights and what else its kind needs
    STORE/<id>/card.json              see `policies.card`
    STORE/active.json                 stack of activations; the last one is in force
    STORE/.lock                       held while anything is written

A policy appears by the rename of a directory that is complete and on disk, and `active.json`
is replaced the same way: whoever reads sees the old or the new, also after a kill or a power
cut. Readers take no lock. Nothing is ever unpickled.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import StoreError
from orbitfb.core.ports import Clock, Policy
from orbitfb.core.signals import Channels
from orbitfb.policies.activations import (
    Activation,
    By,
    chosen,
    newest,
    read_activations,
    with_top,
    without,
    write_activations,
)
from orbitfb.policies.card import PolicyCard, check_identifier, check_ring, finite, read_card
from orbitfb.policies.files import (
    SCHEMA_VERSION,
    publish_directory,
    remove_directory,
    sole_writer,
)
from orbitfb.policies.kinds import StoredPolicy, kind_of
from orbitfb.policies.stability import growth_of, warning_of
from orbitfb.policies.tensors import decode, encode, is_same

_TENSORS = "policy.safetensors"


class PolicyStore:
    """Policies by name, and which of them is in force.

    Args:
        path: The directory; it is made when something is first saved.
        clock: Gives the time on the cards; by default the system's.
    """

    def __init__(self, path: Path, clock: Clock | None = None) -> None:
        self.path = Path(path)
        self._active = self.path / "active.json"
        self._clock = clock or SystemClock()

    def save(
        self,
        policy: Policy,
        channels: Channels,
        parent: str | None = None,
        data_hash: str | None = None,
        figures: Mapping[str, float] | None = None,
        training: Mapping[str, Any] | None = None,
    ) -> str:
        """Store a policy; one that is there already stays as it is, with its first card.

        Args:
            policy: What to store; when correctors are masked, the policy inside is stored.
            channels: The ring that it is for.
            parent: Policy that it was refitted from.
            data_hash: Hash of the data that it was fitted to.
            figures: Judged figures by name, SI.
            training: How it was trained: method, settings, seeds, figures; only what JSON
                can say.

        Returns:
            Its id.

        Raises:
            StoreError: It cannot be written, is of a kind that cannot be stored, or another
                policy has its id.
        """
        kind, inside = kind_of(policy)
        shape = (len(channels.bpms), len(channels.correctors))
        if inside.response.shape != shape:
            raise StoreError(
                f"policy {inside.policy_id} has a response of shape {inside.response.shape}, the "
                f"ring has {shape[0]} BPMs and {shape[1]} correctors; nothing was stored"
            )
        identifier = check_identifier(inside.policy_id)
        content = encode(kind, inside)
        growth = growth_of(inside)
        card = PolicyCard(
            schema_version=SCHEMA_VERSION,
            id=identifier,
            kind=kind.word,
            created=self._clock.wall(),
            parent=parent,
            data_hash=data_hash,
            settings=inside.settings.model_dump(mode="json"),
            figures={k: v if math.isfinite(v) else None for k, v in (figures or {}).items()},
            training=None if training is None else finite(training),
            growth=growth if math.isfinite(growth) else None,
            warning=warning_of(growth),
            planes=channels.planes,
            bpms=channels.bpms,
            correctors=channels.correctors,
            tensor_bytes=len(content),
            tensor_sha256=hashlib.sha256(content).hexdigest(),
        )
        with sole_writer(self.path):
            self._publish(card, content)
        return identifier

    def load(self, identifier: str, channels: Channels) -> StoredPolicy:
        """Load a policy for a ring.

        Raises:
            StoreError: There is none of that name, it is damaged, or it is for another ring.
        """
        card = self.card(identifier)
        path = self.path / identifier / _TENSORS
        check_ring(card, channels, path)
        return decode(path, card)

    def card(self, identifier: str) -> PolicyCard:
        """Read one card.

        Raises:
            StoreError: There is no such policy, or its card is damaged.
        """
        directory = self.path / check_identifier(identifier)
        if not directory.is_dir():
            raise StoreError(
                f"there is no policy {identifier!r} in {self.path}; `orbitfb policies list` shows "
                "those there are"
            )
        return read_card(directory)

    def cards(self, on_damage: Callable[[StoreError], None] | None = None) -> list[PolicyCard]:
        """Read all cards, the oldest first.

        Args:
            on_damage: Told of each damaged policy, so that the others are listed all the same.

        Raises:
            StoreError: A policy is damaged and nobody asked to be told.
        """
        cards: list[PolicyCard] = []
        directories = self.path.iterdir() if self.path.is_dir() else ()
        for directory in directories:
            if directory.name.startswith(".") or not directory.is_dir():
                continue
            try:
                cards.append(self.card(directory.name))
            except StoreError as error:
                if on_damage is None:
                    raise
                on_damage(error)
        return sorted(cards, key=lambda card: (card.created, card.id))

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

    def activate(self, identifier: str, by: By = "operator") -> None:
        """Put a policy in force; activating the active one only makes it the operator's choice.

        Args:
            identifier: Which.
            by: Who does it.

        Raises:
            StoreError: It does not exist or is damaged; the active one stays.
        """
        with sole_writer(self.path):
            self._check_whole(identifier)
            new = Activation(id=identifier, time=self._clock.wall(), by=by)
            stack = self.activations()
            if (after := with_top(stack, new)) != stack:
                write_activations(self._active, after)

    def rollback(self) -> str:
        """Go back to the policy that was active before this one; again: one further.

        Returns:
            The id of the policy now in force.

        Raises:
            StoreError: There is none before it, or it is damaged; the active one stays.
        """
        with sole_writer(self.path):
            stack = self.activations()[:-1]
            if not stack:
                raise StoreError(
                    f"no policy was active before the present one in {self.path}; activate one by "
                    "name instead: `orbitfb policies activate ID`"
                )
            self._check_whole(stack[-1].id)
            back = stack[-1].model_copy(update={"by": "operator"})  # who goes back chooses it
            write_activations(self._active, (*stack[:-1], back))
            return stack[-1].id

    def withdraw(self, identifier: str, restored: str) -> None:
        """Take a policy out of force for good: going back does not lead to it again.

        It stays in the store and can still be activated by name.

        Args:
            identifier: The policy that failed.
            restored: The one that is in force instead.

        Raises:
            StoreError: The one restored does not exist or is damaged; nothing is changed.
        """
        with sole_writer(self.path):
            self._check_whole(restored)
            left = without(self.activations(), identifier, restored, self._clock.wall())
            write_activations(self._active, left)

    def prune(self, keep: int) -> list[str]:
        """Remove policies that are neither among the newest nor among those last in force.

        Args:
            keep: How many of each stay.

        Returns:
            The ids that were removed.

        Raises:
            StoreError: A directory cannot be removed.
        """
        with sole_writer(self.path):
            stack = newest(self.activations(), keep)
            staying = {activation.id for activation in stack}
            cards = self.cards(lambda _: None)  # a damaged one stays, to be looked at
            staying |= {card.id for card in cards[-keep:]}
            leaving = [card.id for card in cards if card.id not in staying]
            if leaving:
                # First, so that no activation names what is gone.
                write_activations(self._active, stack)
            for identifier in leaving:
                try:
                    remove_directory(self.path / identifier)
                except OSError as error:
                    raise StoreError(
                        f"{self.path / identifier} cannot be removed ({error.strerror}); mend the "
                        "permissions"
                    ) from error
        return leaving

    def _check_whole(self, identifier: str) -> None:
        """See that a policy is there and unharmed, as far as that goes without its ring."""
        card = self.card(identifier)
        decode(self.path / identifier / _TENSORS, card)

    def _publish(self, card: PolicyCard, content: bytes) -> None:
        final = self.path / card.id
        if final.exists():
            stored = self.card(card.id)
            if not is_same(stored, card):
                raise StoreError(
                    f"{final} holds another policy of the same id; store this one under another"
                )
            self._check_whole(card.id)
            return
        files = {_TENSORS: content, "card.json": card.model_dump_json(indent=1).encode()}
        try:
            publish_directory(final, files)
        except OSError as error:
            raise StoreError(
                f"policy {card.id} cannot be stored in {self.path} ({error.strerror}); make room "
                "or mend the permissions and save it again"
            ) from error
