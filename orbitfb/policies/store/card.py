"""The card beside a stored policy: what it is, where it comes from, which ring it is for."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from orbitfb.core.errors import StoreError
from orbitfb.core.files.whole import read_json
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels

Owner = Literal["operator", "learner"]
"""Whose a policy is."""

_LARGEST_CARD = 8 * 2**20
_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class PolicyCard(Settings):
    """What `card.json` holds.

    Args:
        schema_version: Version of the files of the store.
        id: Name of the policy and of its directory.
        kind: Which class it is: `svd`, `modal` or `network` (`policies.store.kinds`).
        created: When it was stored [s since the epoch].
        parent: Policy that it was refitted from, if any.
        data_hash: Hash of the data that it was fitted to, if any.
        settings: Settings of its class.
        figures: Judged figures by name, SI; null where one was not finite.
        training: How it was trained, if it was: method, settings, seeds, figures.
        growth: Of the orbit per tick near zero, on its own response (`policies.stability`) [1];
            null: not finite, or not looked at (a card of an earlier version).
        warning: What is wrong with it, if anything is known to be.
        planes: Planes of the ring's channels.
        bpms: Names of the BPMs, in the order of the rows of the response matrix.
        correctors: Names of the correctors, in the order of its columns.
        tensor_bytes: Size of `policy.safetensors`.
        tensor_sha256: Its SHA-256, hexadecimal.
        owner: Whose it is. The learner removes old ones of its own and nothing else; what an
            operator puts in force is the operator's from then on. A card of an earlier version
            does not say, and means the operator.
    """

    schema_version: int
    id: str
    kind: str
    created: float
    parent: str | None
    data_hash: str | None
    settings: dict[str, Any]
    figures: dict[str, float | None]
    training: dict[str, Any] | None = None
    growth: float | None = None
    warning: str | None = None
    planes: str
    bpms: tuple[str, ...]
    correctors: tuple[str, ...]
    tensor_bytes: int
    tensor_sha256: str
    owner: Owner = "operator"


def finite(content: Any) -> Any:
    """Put null in the place of every number that JSON cannot say; mappings become dicts."""
    if isinstance(content, Mapping):
        return {str(key): finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    if isinstance(content, float):
        return float(content) if math.isfinite(content) else None
    return content


def check_identifier(identifier: str) -> str:
    """Return a policy's name if it can be the name of a directory, and of nothing else.

    Raises:
        StoreError: It holds other characters, or too many.
    """
    if not _IDENTIFIER.fullmatch(identifier):
        raise StoreError(
            f"{identifier!r} is no policy id: letters, digits, '.', '_' and '-' are allowed, a "
            "letter or digit first, 100 at most; `orbitfb policies list` shows the ids"
        )
    return identifier


def read_card(directory: Path) -> PolicyCard:
    """Read the card of one policy.

    Args:
        directory: The policy's directory; its name is the id.

    Raises:
        StoreError: The card is missing, damaged, of another version or of another policy.
    """
    path = directory / "card.json"
    advice = f"remove {directory} and refit, or activate another policy"
    content = read_json(path, _LARGEST_CARD, advice)
    try:
        card = PolicyCard.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise StoreError(f"{path}: key '{key}': {first['msg']}; {advice}") from error
    if card.id != directory.name:
        raise StoreError(
            f"{path} is the card of {card.id!r}, not of {directory.name!r}; put the directory "
            "back under its own name"
        )
    return card


def check_ring(card: PolicyCard, channels: Channels, path: Path) -> None:
    """See that a policy was made for these channels.

    Raises:
        StoreError: It belongs to another ring, other planes or another order of channels.
    """
    if card.planes != channels.planes:
        raise StoreError(
            f"{path} is a policy for planes {card.planes!r}, the ring runs {channels.planes!r}; "
            "activate one of these planes or refit"
        )
    for word, stored, present in (
        ("BPMs", card.bpms, channels.bpms),
        ("correctors", card.correctors, channels.correctors),
    ):
        if len(stored) != len(present):
            raise StoreError(
                f"{path} is a policy for {len(stored)} {word}, the ring has {len(present)}; "
                "activate a policy of this ring or refit"
            )
        for index, (theirs, ours) in enumerate(zip(stored, present, strict=True)):
            if theirs != ours:
                raise StoreError(
                    f"{path} is a policy of another ring: number {index} of its {word} is "
                    f"{theirs}, here it is {ours}; activate a policy of this ring or refit"
                )
