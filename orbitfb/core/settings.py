"""The base of every part's configuration model, and how "off" is said in words."""

from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import Any, cast, get_args

from pydantic import BaseModel, ConfigDict
from pydantic.fields import FieldInfo

OFF = ("off", "none")
"""Words for none, beside `false`: TOML and environment variables have no null."""


def _say_off(schema: dict[str, Any], kind: type[Any]) -> None:
    """Let the JSON schema take the words that `without` takes."""
    for name, field in kind.model_fields.items():
        if can_be_off(field) and "anyOf" in (its := schema["properties"].get(name, {})):
            its["anyOf"].append({"enum": [False, *OFF]})


class Settings(BaseModel):
    """A frozen configuration node that refuses unknown keys and non-finite numbers."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        validate_default=True,
        json_schema_extra=_say_off,
    )


def can_be_off(field: FieldInfo) -> bool:
    """Tell whether a key may be none, and the words for it could not mean anything else."""
    kinds = get_args(field.annotation)
    return NoneType in kinds and not {str, bool, Path} & set(kinds)


def without(tree: Mapping[str, Any], model: type[Settings]) -> dict[str, Any]:
    """Turn `false` and the words for off into None, wherever a key may be none.

    Args:
        tree: Values as a file or the environment gives them.
        model: What they are for.
    """
    fields = model.model_fields
    return {name: _without(value, fields.get(name)) for name, value in tree.items()}


def _without(value: Any, field: FieldInfo | None) -> Any:
    if field is None:
        return value
    if isinstance(value, Mapping):
        inner = cast(Mapping[str, Any], value)
        own: object = field.annotation
        if isinstance(own, type) and issubclass(own, Settings):
            return without(inner, own)
        kinds = get_args(own)
        model = next((k for k in kinds if isinstance(k, type) and issubclass(k, Settings)), None)
        if model is None:
            return inner
        # a table of such tables, by name
        return {
            name: without(cast(Mapping[str, Any], its), model) if isinstance(its, Mapping) else its
            for name, its in inner.items()
        }
    said = value is False or (isinstance(value, str) and value.strip().lower() in OFF)
    return None if said and can_be_off(field) else value
