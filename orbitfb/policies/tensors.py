"""The tensors of a stored policy, to bytes and back."""

import hashlib
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from orbitfb.core.errors import OrbitFeedbackError, StoreError
from orbitfb.core.signals import Vector
from orbitfb.policies.card import PolicyCard
from orbitfb.policies.files import read_bounded
from orbitfb.policies.svd import SvdPolicy, SvdSettings

SVD_KIND = "svd"
"""The word for an SVD policy on its card."""

_LARGEST_HEADER = 2**16
_LARGEST_FILE = 2**30


def encode(policy: SvdPolicy) -> bytes:
    """Put the tensors of a policy into one safetensors file."""
    tensors: dict[str, Vector] = {"response": policy.response}
    if policy.covariance is not None:
        tensors["covariance"] = policy.covariance
    return save(tensors)


def decode(path: Path, card: PolicyCard) -> SvdPolicy:
    """Make the policy that a card describes.

    Args:
        path: Its `policy.safetensors`.
        card: Its card.

    Raises:
        StoreError: The file is missing, damaged, exchanged, or not what the card says.
    """
    advice = f"remove {path.parent} and refit, or activate another policy"
    if card.kind != SVD_KIND:
        raise StoreError(f"{path} is of kind {card.kind!r}, unknown to this version; {advice}")
    n, m = len(card.bpms), len(card.correctors)
    largest = min(8 * (n * m + m * m) + _LARGEST_HEADER, _LARGEST_FILE)
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
    shapes = {"response": (n, m), "covariance": (m, m)}
    for name, tensor in tensors.items():
        if tensor.dtype != np.float64 or tensor.shape != shapes.get(name):
            raise StoreError(
                f"{path} holds {name!r} of {tensor.dtype} {tensor.shape}, expected were float64 "
                f"and {shapes}; {advice}"
            )
    if "response" not in tensors:
        raise StoreError(f"{path} holds no response matrix; {advice}")
    try:
        settings = SvdSettings.model_validate(card.settings)
        return SvdPolicy(tensors["response"], settings, card.id, tensors.get("covariance"))
    except (ValidationError, OrbitFeedbackError) as error:
        raise StoreError(f"{path.parent} makes no policy: {error}; {advice}") from error
