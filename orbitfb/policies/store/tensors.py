"""The tensors of a stored policy, to bytes and back."""

import hashlib
from pathlib import Path

from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from orbitfb.core.errors import OrbitFeedbackError, StoreError
from orbitfb.core.files.whole import read_bounded
from orbitfb.policies.store.card import PolicyCard
from orbitfb.policies.store.kinds import Kind, StoredPolicy, kind_named

_LARGEST_HEADER = 2**16
_LARGEST_FILE = 2**30


def encode(kind: Kind, policy: StoredPolicy) -> bytes:
    """Put the tensors of a policy into one safetensors file."""
    return save(kind.take_all(policy))


def decode(path: Path, card: PolicyCard) -> StoredPolicy:
    """Make the policy that a card describes.

    Args:
        path: Its `policy.safetensors`.
        card: Its card.

    Raises:
        StoreError: The file is missing, damaged, exchanged, or not what the card says.
    """
    advice = f"remove {path.parent} and refit, or activate another policy"
    kind = kind_named(card.kind)
    if kind is None:
        raise StoreError(f"{path} is of kind {card.kind!r}, unknown to this version; {advice}")
    n, m = len(card.bpms), len(card.correctors)
    largest = min(kind.largest(n, m) + _LARGEST_HEADER, _LARGEST_FILE)
    content = read_bounded(path, largest, advice)
    if hashlib.sha256(content).hexdigest() != card.tensor_sha256:
        raise StoreError(
            f"{path} ({len(content)} bytes) is not the file that its card names "
            f"({card.tensor_bytes} bytes): damaged or exchanged; {advice}"
        )
    try:
        tensors = load(content)
    except (SafetensorError, ValueError, KeyError, AttributeError) as error:
        raise StoreError(f"{path} is no safetensors file ({error}); {advice}") from error
    mismatch = kind.mismatch(tensors, n, m)
    if mismatch:
        raise StoreError(f"{path} holds {mismatch}; {advice}")
    try:
        settings = kind.settings.model_validate(card.settings)
        return kind.make_all(tensors, settings, card.id)
    except (ValidationError, OrbitFeedbackError) as error:
        raise StoreError(f"{path.parent} makes no policy: {error}; {advice}") from error


def is_same(stored: PolicyCard, card: PolicyCard) -> bool:
    """Tell whether two cards are of one policy; a setting that one does not name is the default."""
    kind = kind_named(card.kind)
    if kind is None or stored.kind != card.kind or stored.tensor_sha256 != card.tensor_sha256:
        return False
    try:
        return kind.settings.model_validate(stored.settings) == kind.settings.model_validate(
            card.settings
        )
    except ValidationError:
        return False
