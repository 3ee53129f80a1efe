"""Paths within a configuration are those seen from its file, wherever the program is started."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast, get_args

from orbitfb.core.settings import Settings


def seen_from(tree: Mapping[str, Any], model: type[Settings], directory: Path) -> dict[str, Any]:
    """Turn every relative path of a tree into one that leads there from the working directory.

    Args:
        tree: Values as the file gives them, by key.
        model: What they are for; a key whose type is a path is one.
        directory: Of the file.
    """
    fields = model.model_fields
    return {
        key: _seen(value, fields[key].annotation, directory) if key in fields else value
        for key, value in tree.items()
    }


def _seen(value: Any, kind: Any, directory: Path) -> Any:
    if isinstance(value, str):
        its_path = value and Path in (get_args(kind) or (kind,))
        return str(directory / value) if its_path else value
    if isinstance(value, Mapping) and isinstance(kind, type) and issubclass(kind, Settings):
        return seen_from(cast(Mapping[str, Any], value), kind, directory)
    return cast(Any, value)
