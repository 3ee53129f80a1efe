"""Which policies were put in force, one after the other: `active.json` of a store."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from orbitfb.core.errors import StoreError
from orbitfb.core.settings import Settings
from orbitfb.policies.card import check_identifier
from orbitfb.policies.files import SCHEMA_VERSION, read_json, replace_file

_LARGEST = 2**20
_KEPT = 200


class Activation(Settings):
    """One line of `active.json`.

    Args:
        id: The policy that was put in force.
        time: When [s since the epoch].
    """

    id: str
    time: float


class _Activations(Settings):
    schema_version: int = SCHEMA_VERSION
    activations: tuple[Activation, ...] = ()


def read_activations(path: Path) -> tuple[Activation, ...]:
    """Read the stack, the one in force last; empty when there is no such file.

    Raises:
        StoreError: It is damaged.
    """
    if not path.exists():
        return ()
    advice = f"remove {path} and activate a policy by name"
    content = read_json(path, _LARGEST, advice)
    try:
        stack = _Activations.model_validate(content).activations
    except ValidationError as error:
        raise StoreError(f"{path} holds no list of activations; {advice}") from error
    for activation in stack:
        check_identifier(activation.id)
    return stack


def write_activations(path: Path, stack: Sequence[Activation]) -> None:
    """Write the stack, the oldest beyond 200 left out.

    Raises:
        StoreError: It cannot be written; the old one stays.
    """
    content = _Activations(activations=tuple(stack)[-_KEPT:])
    try:
        replace_file(path, content.model_dump_json(indent=1).encode())
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written ({error.strerror}); the active policy is unchanged"
        ) from error


def without(
    stack: Sequence[Activation], identifier: str, restored: str, now: float
) -> tuple[Activation, ...]:
    """Give the stack as if a policy had never been in force.

    Args:
        stack: The one in force last.
        identifier: The policy to leave out.
        restored: The policy in force instead.
        now: Time [s since the epoch].
    """
    others = [entry for entry in stack if entry.id != identifier]
    if not others or others[-1].id != restored:
        others.append(Activation(id=restored, time=now))
    before = [None, *others]  # what stood on either side of it may be one policy twice
    return tuple(
        entry
        for entry, last in zip(others, before, strict=False)
        if last is None or entry.id != last.id
    )
