"""One task, what came of it, and how both are written down."""

import base64
import hashlib
import importlib
import importlib.util
import io
import json
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

import orbitfb
from orbitfb.core.errors import ConfigError

_PACKAGE = Path(orbitfb.__file__).parent
_LONGEST = 400


@dataclass(frozen=True, slots=True)
class Task:
    """A call of a function, as text, so that any process can make it.

    Args:
        function: `module:function`; it takes the arguments by name and returns a mapping. What
            it returns must be JSON, except that values at the top may be numpy arrays.
        arguments: By name; JSON.
    """

    function: str
    arguments: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Hash of function, arguments and source: the same key, the same result."""
        text = json.dumps([self.function, self.arguments], sort_keys=True)
        return hashlib.sha256(f"{text} {source(self.function)}".encode()).hexdigest()[:24]

    def __str__(self) -> str:
        text = json.dumps(self.arguments, sort_keys=True)
        shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
        return f"{self.function} with {shown}"


class Outcome(NamedTuple):
    """What came of a task, ready to be sent or stored: either a result or an error.

    Args:
        text: The result without its arrays, as JSON.
        arrays: The arrays, an npz file; empty if there are none.
        error: What went wrong in one line; empty if nothing did.
        trace: Where it went wrong.
    """

    text: str = ""
    arrays: bytes = b""
    error: str = ""
    trace: str = ""

    def to_line(self) -> bytes:
        """Write it as one line of JSON."""
        fields = {**self._asdict(), "arrays": base64.b64encode(self.arrays).decode()}
        return json.dumps(fields).encode() + b"\n"

    @classmethod
    def from_line(cls, line: bytes) -> "Outcome":
        """Read what `to_line` wrote."""
        fields: dict[str, Any] = json.loads(line)
        fields["arrays"] = base64.b64decode(fields["arrays"])
        return cls(**fields)

    def result(self) -> dict[str, Any]:
        """Give back what the function returned; a tuple has become a list."""
        found = cast(dict[str, Any], json.loads(self.text))
        if self.arrays:
            with np.load(io.BytesIO(self.arrays), allow_pickle=False) as stored:
                found |= {name: stored[name] for name in stored.files}
        return found


def resolve(function: str) -> Callable[..., Mapping[str, Any]]:
    """Find `module:function`.

    Raises:
        ConfigError: There is none.
    """
    module, _, name = function.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(
            f"no function {function!r}: {error}; name it `module:function`, in a module that "
            "every worker can import"
        ) from error


def execute(function: str, arguments: Mapping[str, Any], expected: str | None = None) -> Outcome:
    """Run a task; an error becomes part of the outcome.

    Args:
        function: `module:function`.
        arguments: By name.
        expected: Hash of the source that the asker has; None: not compared.
    """
    try:
        if expected is not None and expected != (own := source(function)):
            raise ConfigError(
                f"this worker has another source of orbitfb or of {function} ({own[:12]}) than "
                f"the asker ({expected[:12]}); install the same version on all of them"
            )
        return encode(resolve(function)(**arguments))
    except (Exception, SystemExit) as error:  # the outermost guard: the asker reports it
        return Outcome(error=f"{type(error).__name__}: {error}", trace=traceback.format_exc())


def encode(result: Mapping[str, Any]) -> Outcome:
    """Write a result down.

    Raises:
        TypeError: It is no mapping, or something in it is neither JSON nor an array at the top.
    """
    if not isinstance(result, Mapping):
        raise TypeError(f"a task must return a mapping, not {type(result).__name__}")
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    plain = {name: value for name, value in result.items() if name not in arrays}
    packed = io.BytesIO()
    if arrays:
        np.savez_compressed(packed, allow_pickle=False, **cast(dict[str, Any], arrays))
    return Outcome(text=json.dumps(plain, default=_scalar), arrays=packed.getvalue())


def _scalar(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not JSON; arrays must stand at the top")


def source(function: str) -> str:
    """Hash what decides a result besides its arguments: the package and the function's module."""
    return _source_of(function.partition(":")[0])


@cache
def _source_of(module: str) -> str:
    digest = hashlib.sha256(orbitfb.__version__.encode())
    paths = [path for kind in ("*.py", "data/*") for path in _PACKAGE.rglob(kind)]
    if module.partition(".")[0] != _PACKAGE.name:
        try:
            found = importlib.util.find_spec(module)
        except (ImportError, ValueError):
            found = None  # `resolve` says so where it is run
        if found is not None and found.origin is not None and Path(found.origin).is_file():
            paths.append(Path(found.origin))
    for path in sorted(paths):
        own = path.is_relative_to(_PACKAGE)
        digest.update(str(path.relative_to(_PACKAGE) if own else path.name).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
