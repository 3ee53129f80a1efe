"""Which policies were put in force, one after the other: `active.json` of a store."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from orbitfb.core.errors import StoreError
from orbitfb.core.files.whole import SCHEMA_VERSION, read_json, replace_file
from orbitfb.core.settings import Settings
from orbitfb.policies.store.card import check_identifier

By = Literal["operator", "service"]
"""Who put a policy in force: somebody by name, or a service that started or promoted it."""

_LARGEST = 2**20
_KEPT = 200


class Probation(Settings):
    """A promotion that has not proved itself yet.

    Args:
        former: The policy to go back to.
        before: Observed orbit before the swap, rms [m]; None: not known.
        seen: Ticks for which it was watched [ticks].
        suspended: Whether its watch was suspended by a service that ended in good order, so that
            the next one may go on; after a kill it is False, and nobody knows what happened.
    """

    former: str
    before: float | None = None
    seen: int = 0
    suspended: bool = False


class Activation(Settings):
    """One line of `active.json`.

    Args:
        id: The policy that was put in force.
        time: When [s since the epoch].
        by: Who did it; a file of an earlier version does not say, and means the service.
        probation: What is to be known while it is watched; None: it is not.
    """

    id: str
    time: float
    by: By = "service"
    probation: Probation | None = None


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
    """Write the stack, the oldest beyond 200 left out, but not what an operator chose last.

    Raises:
        StoreError: It cannot be written; the old one stays.
    """
    content = _Activations(activations=newest(stack, _KEPT))
    try:
        replace_file(path, content.model_dump_json(indent=1, exclude_none=True).encode())
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written ({error.strerror}); the active policy is unchanged"
        ) from error


def chosen(stack: Sequence[Activation]) -> Activation | None:
    """Give what an operator put in force last; None: nothing is left of that."""
    return next((entry for entry in reversed(stack) if entry.by == "operator"), None)


def with_top(stack: Sequence[Activation], new: Activation) -> tuple[Activation, ...]:
    """Give the stack with a policy in force; what an operator put in force stays the operator's."""
    if not stack or stack[-1].id != new.id:
        return (*stack, new)
    return (*stack[:-1], new) if new.by == "operator" else tuple(stack)


def with_probation(
    stack: Sequence[Activation], identifier: str, probation: Probation | None
) -> tuple[Activation, ...]:
    """Give the stack with another probation of the policy in force, if it is still that one.

    Args:
        stack: The one in force last.
        identifier: The policy that is meant.
        probation: None: it has proved itself.
    """
    if not stack or stack[-1].id != identifier or stack[-1].probation is None:
        return tuple(stack)
    return (*stack[:-1], stack[-1].model_copy(update={"probation": probation}))


def back_from(
    stack: Sequence[Activation], why_not: Callable[[str], str]
) -> tuple[tuple[Activation, ...], dict[str, str]]:
    """Give the stack after going back, and what was passed over with why.

    Args:
        stack: The one in force last.
        why_not: Says why a policy must not be gone back to; empty: it may.

    Returns:
        The stack, its last one to be put in force; empty when there is none to go back to.
    """
    earlier = list(stack[:-1])
    passed: dict[str, str] = {}
    while earlier:
        last = earlier[-1].id
        if last != stack[-1].id:  # that one is left, so it cannot be what is gone back to
            if not (reason := why_not(last)):
                break
            passed[last] = reason
        earlier.pop()
    return tuple(earlier), passed


def newest(stack: Sequence[Activation], keep: int) -> tuple[Activation, ...]:
    """Give the last activations, and before them the operator's last, whatever came after it.

    Args:
        stack: The one in force last.
        keep: How many stay.
    """
    last = tuple(stack)[-keep:]
    theirs = chosen(stack)
    return last if theirs is None or chosen(last) else (theirs, *last)


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
