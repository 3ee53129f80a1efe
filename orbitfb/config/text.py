"""A configuration as the text of a file that people read and change."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from orbitfb.core.settings import Settings, can_be_off


def to_toml(config: Settings) -> str:
    """Write a configuration as TOML, each key below its meaning.

    Keys whose value is None, which TOML cannot say, are written as `false` where that is not their
    default, else as comments.
    """
    return "\n".join(_section(config, "")).strip() + "\n"


def _section(model: Settings, table: str) -> Iterator[str]:
    fields = type(model).model_fields
    nested = {name for name in fields if isinstance(getattr(model, name), Settings)}
    if table:
        yield f"\n[{table}]"
    for name in fields:
        if name not in nested:
            value = getattr(model, name)
            yield f"# {fields[name].description}"
            if value is None and fields[name].default is not None and can_be_off(fields[name]):
                value = False
            yield f"# {name} =" if value is None else f"{name} = {_toml_value(value)}"
    for name in fields:
        if name in nested:
            yield from _section(getattr(model, name), f"{table}.{name}" if table else name)


def _toml_value(value: Any) -> str:
    if isinstance(value, Settings):
        value = value.model_dump(by_alias=True)
    if isinstance(value, Mapping):
        items = ", ".join(
            f"{json.dumps(str(key))} = {_toml_value(item)}"
            for key, item in value.items()
            if item is not None
        )
        return "{ " + items + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, bool | int | float):
        return json.dumps(value)
    return json.dumps(str(value), ensure_ascii=False)
