"""What is checked: a callable from a record to an answer in the form of `diagnosis.json`."""

import hashlib
import importlib
import importlib.util
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

INSTALLED = "benchmarks.blind.engines:installed"
"""The diagnosis as `orbitfb diagnose` has it."""

Engine = Callable[..., dict[str, Any]]
"""Called with the path of the record, and with those of the keywords `later` (a later record),
`ring` (table of places and parameters) and `without` (ids that it is to lack) that it declares."""


class EngineError(Exception):
    """An engine that cannot be used: which, why, what to do."""


def installed(
    record: Path,
    *,
    later: Path | None = None,
    ring: tuple[Path, Path] | None = None,
    without: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Diagnose a record by the public interface of the package."""
    from orbitfb.diagnose.result.diagnosis import document
    from orbitfb.diagnose.verdict.files import diagnose_files
    from orbitfb.physics.places import Ring

    answer = diagnose_files(
        record,
        None,
        later,
        planes=None,
        ring=Ring.load(*(ring or (None, None))),
        seed=0,
        without=frozenset(without),
        progress=lambda what, share: None,
    )
    return json.loads(document(answer))


def load(name: str) -> Engine:
    """Import an engine.

    Args:
        name: As `module:function`.

    Raises:
        EngineError: There is no such module or function.
    """
    module, _, function = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise EngineError(
            f"--engine {name}: {error}; give module:function, a callable(record path) that gives "
            "a dictionary in the form of diagnosis.json"
        ) from error
    if not callable(found):
        raise EngineError(f"--engine {name}: it is not callable")
    return cast(Engine, found)


def ask(engine: Engine, record: Path, **told: Any) -> dict[str, Any]:
    """Call an engine with what it wants to know.

    Raises:
        EngineError: Something is told that it has to heed, and it has no keyword for it.
    """
    wants = inspect.signature(engine).parameters
    every = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in wants.values())
    if told.get("without") and not every and "without" not in wants:
        raise EngineError("it has no keyword `without`: it cannot leave an effect out")
    return engine(record, **{name: v for name, v in told.items() if every or name in wants})


def fingerprint(name: str) -> str:
    """Tell one state of an engine's code from another: a hash of all sources beside its own.

    Answers of another state are not kept: they would be scored as this one's.
    """
    digest = hashlib.sha256(name.encode())
    roots = {"orbitfb", name.partition(":")[0].partition(".")[0]}
    for root in sorted(roots):
        found = importlib.util.find_spec(root)
        if found is None:
            continue
        places = [Path(place) for place in found.submodule_search_locations or ()]
        files = [f for place in places for f in sorted(place.rglob("*.py"))]
        if not places and found.origin:
            files = [Path(found.origin)]
        for file in files:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
