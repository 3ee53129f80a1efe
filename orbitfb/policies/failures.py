"""Which policies failed in force, and how: `failures.json` of a store.

A policy is named by its content. What is on record here stays when the policy itself is removed:
the same content may come again, from the learner or from a file.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from orbitfb.core.errors import StoreError
from orbitfb.core.files.whole import SCHEMA_VERSION, read_json, replace_file
from orbitfb.core.settings import Settings
from orbitfb.policies.store.card import check_identifier

Cause = Literal["tripped", "rolled_back"]
"""How a policy failed: it was in force when the loop tripped, or the learner took it back."""

_KEPT = 1000
_LARGEST = 2**20
_LONGEST = 400
"""A thousand reasons of this length, with id and time, are below the largest file."""
_WORDS: Mapping[str, str] = {"tripped": "tripped the loop", "rolled_back": "was rolled back"}


class Failure(Settings):
    """How a policy failed last.

    Args:
        id: The policy.
        time: When [s since the epoch].
        cause: How.
        reason: What the loop or the learner said.
    """

    id: str
    time: float
    cause: Cause
    reason: str

    @property
    def words(self) -> str:
        """One sentence for people."""
        return f"{_WORDS[self.cause]}: {self.reason}"


class _Failures(Settings):
    schema_version: int = SCHEMA_VERSION
    failures: tuple[Failure, ...] = ()


def read_failures(path: Path) -> dict[str, Failure]:
    """Read the last failure of every policy that failed; empty when there is no such file.

    Raises:
        StoreError: It is damaged.
    """
    if not path.exists():
        return {}
    advice = f"repair {path}, or remove it: then it is forgotten which policies failed"
    try:
        failures = _Failures.model_validate(read_json(path, _LARGEST, advice)).failures
    except ValidationError as error:
        raise StoreError(f"{path} holds no list of failures; {advice}") from error
    return {check_identifier(failure.id): failure for failure in failures}


def add_failure(path: Path, failure: Failure) -> None:
    """Write one more failure, in place of an earlier one of the same policy; the newest 1000 stay.

    Raises:
        StoreError: The file is damaged, or cannot be written.
    """
    known = read_failures(path)
    known.pop(failure.id, None)
    short = failure.model_copy(update={"reason": failure.reason[:_LONGEST]})
    content = _Failures(failures=(*known.values(), short)[-_KEPT:])
    try:
        replace_file(path, content.model_dump_json(indent=1).encode())
    except OSError as error:
        raise StoreError(f"{path} cannot be written ({error.strerror}); make room") from error
