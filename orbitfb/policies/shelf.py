"""A directory of policies: tensors in safetensors, a JSON card beside them.

    STORE/<id>/policy.safetensors     response matrix, weights and what else its kind needs
    STORE/<id>/card.json              see `policies.store.card`
    STORE/.lock                       held while anything is written

A policy appears by the rename of a directory that is complete and on disk: whoever reads sees it
whole or not at all, also after a kill or a power cut. Readers take no lock. Nothing is ever
unpickled. Which of the policies is in force is the matter of `policies.store.directory`.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import StoreError
from orbitfb.core.files.whole import SCHEMA_VERSION, publish_directory, replace_file, sole_writer
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.ports import Clock, Policy
from orbitfb.core.signals import Channels
from orbitfb.policies.stability import growth_of, warning_of
from orbitfb.policies.store.card import (
    Owner,
    PolicyCard,
    check_identifier,
    check_ring,
    finite,
    read_card,
)
from orbitfb.policies.store.kinds import StoredPolicy, kind_of
from orbitfb.policies.store.tensors import decode, encode, is_same

_TENSORS = "policy.safetensors"


class PolicyShelf:
    """Policies by name.

    Args:
        path: The directory; it is made when something is first saved.
        clock: Gives the time on the cards; by default the system's.
    """

    def __init__(self, path: Path, clock: Clock | None = None) -> None:
        self.path = Path(path)
        self._clock = clock or SystemClock()

    def save(
        self,
        policy: Policy,
        channels: Channels,
        parent: str | None = None,
        data_hash: str | None = None,
        figures: Mapping[str, float] | None = None,
        training: Mapping[str, Any] | None = None,
        owner: Owner = "operator",
    ) -> str:
        """Store a policy; one that is there already stays as it is, with its first card.

        Only whose it is may change: what the learner made and an operator stores as well is the
        operator's from then on.

        Args:
            policy: What to store; when correctors are masked, the policy inside is stored.
            channels: The ring that it is for.
            parent: Policy that it was refitted from.
            data_hash: Hash of the data that it was fitted to.
            figures: Judged figures by name, SI.
            training: How it was trained: method, settings, seeds, figures; only what JSON
                can say.
            owner: Whose it is; the learner may remove its own.

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
            warning=warning_of(inside),
            planes=channels.planes,
            bpms=channels.bpms,
            correctors=channels.correctors,
            tensor_bytes=len(content),
            tensor_sha256=hashlib.sha256(content).hexdigest(),
            owner=owner,
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
            known = (path.name for path in self.path.glob("[!.]*") if path.is_dir())
            raise StoreError(
                f"there is no policy {identifier!r}{did_you_mean(identifier, known)} in "
                f"{self.path}; `orbitfb policies list` shows those there are"
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

    def _adopt(self, identifier: str) -> None:
        """Make a policy of the learner's the operator's, so that it is not removed."""
        card = self.card(identifier)
        if card.owner == "operator":
            return
        path = self.path / identifier / "card.json"
        mine = card.model_copy(update={"owner": "operator"})
        try:
            replace_file(path, mine.model_dump_json(indent=1).encode())
        except OSError as error:
            raise StoreError(f"{path} cannot be written ({error.strerror}); make room") from error

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
            if card.owner == "operator":
                self._adopt(card.id)
            return
        files = {_TENSORS: content, "card.json": card.model_dump_json(indent=1).encode()}
        try:
            publish_directory(final, files)
        except OSError as error:
            raise StoreError(
                f"policy {card.id} cannot be stored in {self.path} ({error.strerror}); make room "
                "or repair the permissions and save it again"
            ) from error
