"""A forward net on disk: tensors in safetensors, a JSON card beside them, nothing pickled.

    DIRECTORY/card.json                     schema, shapes, figures, curve, name and hash of
    DIRECTORY/forward-<hash>.safetensors    response, coordinates, weights

The tensors are written first; the card, which names them, takes its place at once.
"""

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from orbitfb.core.errors import StoreError
from orbitfb.core.files.bounded import take
from orbitfb.core.files.state import make_directory, replace_file
from orbitfb.core.settings import Settings
from orbitfb.models.forward.net import Coordinates, ForwardNet

SCHEMA_VERSION = 1
_LARGEST_CARD = 2**22
_LARGEST_TENSORS = 2**30
_COORDINATES = ("modes", "directions", "orbit", "change", "answer")


class _Card(Settings):
    schema_version: int
    bpms: int = Field(ge=1)
    correctors: int = Field(ge=1)
    members: int = Field(ge=1, le=64)
    layers: int = Field(ge=1, le=8)
    figures: dict[str, float | None]
    curve: tuple[float, ...]
    tensors: str
    bytes: int = Field(ge=1, le=_LARGEST_TENSORS)
    sha256: str


def save_forward(net: ForwardNet, directory: Path) -> None:
    """Write a net in the place of what was there.

    Raises:
        StoreError: It cannot be written; what was there stays.
    """
    tensors: dict[str, NDArray[Any]] = {"response": net.response}
    tensors |= {name: getattr(net.coordinates, name) for name in _COORDINATES}
    for member, weights in enumerate(net.members):
        tensors |= {f"member.{member}.{layer}": weight for layer, weight in enumerate(weights)}
    content = save_tensors({name: np.ascontiguousarray(array) for name, array in tensors.items()})
    digest = hashlib.sha256(content).hexdigest()
    card = _Card(
        schema_version=SCHEMA_VERSION,
        bpms=net.response.shape[0],
        correctors=net.response.shape[1],
        members=len(net.members),
        layers=len(net.members[0]),
        figures={k: v if math.isfinite(v) else None for k, v in net.figures.items()},
        curve=tuple(net.curve),
        tensors=f"forward-{digest[:16]}.safetensors",
        bytes=len(content),
        sha256=digest,
    )
    try:
        make_directory(directory)
        replace_file(directory / card.tensors, content)
        replace_file(directory / "card.json", card.model_dump_json(indent=1).encode())
        for path in directory.glob("forward-*.safetensors"):
            if path.name != card.tensors:
                path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(
            f"the forward net cannot be written to {directory} ({error.strerror}); name another "
            "directory or repair its permissions"
        ) from error


def load_forward(directory: Path) -> ForwardNet:
    """Read a net.

    Raises:
        StoreError: There is none, it is damaged, exchanged, or of another version.
    """
    advice = "fit it again"
    path = directory / "card.json"
    try:
        with path.open("rb") as file:
            card = _Card.model_validate(json.loads(file.read(_LARGEST_CARD)))
        if card.schema_version != SCHEMA_VERSION:
            raise StoreError(f"{path} is of version {card.schema_version}, not 1; {advice}")
        if Path(card.tensors).name != card.tensors:
            raise StoreError(f"{path} names tensors outside its directory; {advice}")
        with (directory / card.tensors).open("rb") as file:
            content = take(file, card.bytes + 1)
        if hashlib.sha256(content).hexdigest() != card.sha256:
            raise StoreError(f"{directory / card.tensors} is damaged or exchanged; {advice}")
        tensors = load_tensors(content)
    except OSError as error:
        raise StoreError(
            f"{directory} holds no forward net ({error.strerror}); {advice}"
        ) from error
    except (ValueError, RecursionError, SafetensorError) as error:
        raise StoreError(f"{directory} holds a damaged forward net ({error}); {advice}") from error
    _check(card, tensors, directory, advice)
    members = tuple(
        tuple(tensors[f"member.{member}.{layer}"] for layer in range(card.layers))
        for member in range(card.members)
    )
    at = Coordinates(*(tensors[name] for name in _COORDINATES))
    figures = {name: math.nan if v is None else v for name, v in card.figures.items()}
    return ForwardNet(tensors["response"], at, members, figures, card.curve)


def _check(card: _Card, tensors: dict[str, NDArray[Any]], directory: Path, advice: str) -> None:
    """Hold the tensors against the card: names, shapes, numbers.

    Raises:
        StoreError: They do not fit.
    """
    n, m = card.bpms, card.correctors
    expected = {
        "response": (n, m),
        "modes": (n, n),
        "directions": (m, m),
        "orbit": (n,),
        "change": (m,),
        "answer": (n,),
    }
    names = {f"member.{k}.{j}" for k in range(card.members) for j in range(card.layers)}
    fault = None
    if tensors.keys() != expected.keys() | names:
        fault = "other tensors than the card says"
    elif any(tensors[name].shape != shape for name, shape in expected.items()):
        fault = "tensors of other shapes than the card says"
    elif any(tensors[name].dtype != np.float64 for name in expected) or any(
        tensors[name].dtype != np.float32 or tensors[name].ndim != 2 for name in names
    ):
        fault = "tensors of another kind of number"
    elif not all(np.isfinite(array).all() for array in tensors.values()):
        fault = "numbers that are not finite"
    else:
        for member in range(card.members):
            width = n + m
            for layer in range(card.layers):
                shape = tensors[f"member.{member}.{layer}"].shape
                if shape[1] != width:
                    fault = "layers that do not fit together"
                width = shape[0]
            if width != n:
                fault = "layers that do not fit together"
    if fault is not None:
        raise StoreError(f"{directory} holds {fault}; {advice}")
