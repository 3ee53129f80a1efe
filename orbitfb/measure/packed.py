"""Arrays with a card in one safetensors file: written whole or not at all, bounded when read."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from orbitfb.core.errors import MeasurementError, OrbitFeedbackError
from orbitfb.core.files.whole import read_bounded, replace_file
from orbitfb.core.signals import Vector

SCHEMA_VERSION = 1
_CARD = "card"
_LARGEST_CARD = 2**22
_LARGEST_FILE = 2**30


def write_packed(path: Path, tensors: Mapping[str, Vector], card: Mapping[str, Any]) -> None:
    """Write a file.

    Raises:
        MeasurementError: It cannot be written; what was there before stays.
    """
    text = json.dumps({"schema_version": SCHEMA_VERSION, **card}, allow_nan=False)
    arrays = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    try:
        replace_file(path, save(arrays, metadata={_CARD: text}))
    except OSError as error:
        raise MeasurementError(
            f"{path} cannot be written ({error.strerror}); make room or name another place"
        ) from error


def read_packed(
    path: Path, kind: str, advice: str, refuse: type[OrbitFeedbackError]
) -> tuple[dict[str, Vector], dict[str, Any]]:
    """Read a file.

    Args:
        path: The file.
        kind: That its card must say.
        advice: What to do when it is damaged.
        refuse: Error to raise.

    Returns:
        Arrays of float64 by name, and the card.
    """
    try:
        content = read_bounded(path, _LARGEST_FILE, advice)
    except OrbitFeedbackError as error:
        raise refuse(str(error)) from error
    try:
        card = _card(content)
        tensors = load(content)
    except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise refuse(f"{path} is not readable ({error}); {advice}") from error
    if card.get("kind") != kind or card.get("schema_version") != SCHEMA_VERSION:
        raise refuse(
            f"{path} is {card.get('kind')!r} of version {card.get('schema_version')!r}, not "
            f"{kind!r} of version {SCHEMA_VERSION}; {advice}"
        )
    if any(tensor.dtype != np.float64 for tensor in tensors.values()):
        raise refuse(f"{path} holds arrays that are not float64; {advice}")
    return tensors, card


def _card(content: bytes) -> dict[str, Any]:
    """Take the card out of the header: 8 bytes of length, then JSON (safetensors format)."""
    length = int.from_bytes(content[:8], "little")
    if not 0 < length <= min(_LARGEST_CARD, len(content) - 8):
        raise ValueError("its header is cut off or too long")
    card = json.loads(json.loads(content[8 : 8 + length])["__metadata__"][_CARD])
    if not isinstance(card, dict):
        raise ValueError("its card is no object")
    return card
