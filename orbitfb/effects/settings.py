"""Effects of a simulated ring as they are configured: which, where, how large, from when on."""

from collections.abc import Iterator
from typing import Any

from pydantic import ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from orbitfb.core.errors import ConfigError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.settings import Settings
from orbitfb.core.units import parse_quantity
from orbitfb.effects.kinds import EffectKind, Parameter
from orbitfb.effects.registry import effect
from orbitfb.physics.places import Planes

ALL = "all"
_PLACE_KEYS = ("cells", "names")


class EffectSettings(Settings):
    """One effect of a simulated ring."""

    model_config = ConfigDict(populate_by_name=True)

    id: str = Field(description="Which effect; `orbitfb effects` lists them.")
    cells: tuple[str, ...] = Field(
        default=(),
        description="Cells whose devices have it: `3`, `C03`, a range `3-5` along the ring, "
        "which may pass its beginning (`5-3`: all but 4); none: all.",
    )
    names: tuple[str, ...] = Field(
        default=(), description="Names of the devices that have it; none: all."
    )
    planes: Planes = Field(default="xy", description="Planes of these devices that have it.")
    values: dict[str, float] = Field(
        default={},
        description="Its parameters by name: a number (SI), or a text with a unit, `50ms`, `2%`; "
        "those left out are typical.",
    )
    elements: dict[str, float] = Field(
        default={},
        description="Errors of single elements of the response [m/A] by the name of the other "
        "device, of an effect that has them; none: drawn at random, of the size in `values`.",
    )
    since: float = Field(
        default=0.0,
        ge=0,
        validation_alias="from",
        serialization_alias="from",
        description="When it begins: a number, or a text with a unit, after the start of the "
        "ring [s].",
    )

    @field_validator("id")
    @classmethod
    def _known(cls, name: str) -> str:
        try:
            effect(name)
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return name

    @field_validator("cells", "names", mode="before")
    @classmethod
    def _listed(cls, given: Any) -> Any:
        """Take one text for a list of one; `all` for no choice; a number for a cell."""
        items = given if isinstance(given, list | tuple) else (given,)
        if len(items) == 1 and items[0] == ALL:
            return ()
        numbers = (int, str)
        if not all(isinstance(item, numbers) and not isinstance(item, bool) for item in items):
            raise ValueError("give texts, or numbers of cells")
        return tuple(str(item).strip() for item in items)

    @field_validator("names")
    @classmethod
    def _one_choice(cls, names: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        if names and info.data.get("cells"):
            raise ValueError("choose the devices by cells or by names, not by both")
        return names

    @field_validator("values", mode="before")
    @classmethod
    def _in_si(cls, given: Any, info: ValidationInfo) -> Any:
        if "id" not in info.data or not isinstance(given, dict):
            return {} if "id" not in info.data else given
        kind = effect(info.data["id"])
        return {name: _value(kind, name, value) for name, value in given.items()}

    @field_validator("elements")
    @classmethod
    def _has_elements(cls, given: dict[str, float], info: ValidationInfo) -> dict[str, float]:
        if given and "id" in info.data and not effect(info.data["id"]).elemental:
            raise ValueError(f"{info.data['id']} does not act on single elements of the response")
        return given

    @field_validator("since", mode="before")
    @classmethod
    def _in_seconds(cls, given: Any) -> Any:
        return parse_quantity(given, "s") if isinstance(given, str) else given

    @property
    def kind(self) -> EffectKind:
        """The kind of effect."""
        return effect(self.id)

    @property
    def filled(self) -> dict[str, float]:
        """All parameters, those left out typical, SI."""
        return {p.name: self.values.get(p.name, p.typical) for p in self.kind.parameters}

    @property
    def text(self) -> str:
        """The effect as `--effect` takes it."""
        words = [f"{name}={value!r}" for name, value in self.values.items()]
        words += [f"{key}={'+'.join(items)}" for key in _PLACE_KEYS if (items := self._get(key))]
        if self.planes != "xy":
            words.append(f"planes={self.planes}")
        if self.since:
            words.append(f"from={self.since!r}")
        return f"{self.id}:{','.join(words)}" if words else self.id

    def _get(self, key: str) -> tuple[str, ...]:
        return self.cells if key == "cells" else self.names


def parse_effect(text: str, origin: str = "--effect") -> EffectSettings:
    """Read `corrector-lag:tau=0.1s,cells=3-5,from=30s,planes=x`; lists are joined by `+`.

    Args:
        text: The id and, after a colon, parameters, `cells`, `names`, `planes`, `from`.
        origin: Where it comes from, for the message.

    Raises:
        ConfigError: It cannot be read; names effect, key, what is allowed.
    """
    name, colon, rest = text.strip().partition(":")
    if colon and not rest.strip():
        raise ConfigError(
            f"{origin} {text}: nothing follows the colon; write KEY=VALUE pairs, for example "
            f"{name}:cells=3-5,from=30s, or {name} alone for typical values everywhere"
        )
    tree: dict[str, Any] = {"id": name.strip(), "values": {}}
    seen: set[str] = set()
    for word in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (part.strip() for part in word.partition("="))
        if not equals or not key or not value:
            raise ConfigError(
                f"{origin} {text}: {word!r} is not KEY=VALUE; write for example "
                f"{name}:cells=3-5,from=30s, and several names or cells with a + between"
            )
        if key in seen:
            raise ConfigError(f"{origin} {text}: {key} is given twice")
        seen.add(key)
        if key in _PLACE_KEYS:
            tree[key] = value.split("+")
        elif key in ("planes", "from"):
            tree[key] = value
        else:
            tree["values"][key] = value
    return read_effect(tree, f"{origin} {text}")


def read_effect(tree: Any, origin: str) -> EffectSettings:
    """Read an effect from a table of keys.

    Args:
        tree: As in a TOML file.
        origin: Where it comes from, for the message.

    Raises:
        ConfigError: A key or value is wrong; all of them at once.
    """
    try:
        return EffectSettings.model_validate(tree)
    except ValidationError as error:
        name = tree.get("id", "?") if isinstance(tree, dict) else "?"
        raise ConfigError(f"{origin}: " + "; ".join(_problems(error, str(name)))) from None


def _problems(error: ValidationError, name: str) -> Iterator[str]:
    for problem in error.errors():
        key = ".".join(str(part) for part in problem["loc"])
        said = problem["msg"].removeprefix("Value error, ")
        if key == "id":
            yield said if problem["type"] != "missing" else "the key id is missing"
        elif problem["type"] == "extra_forbidden":
            known = ", ".join(keys())
            yield f"effect {name}: no such key: {key}{did_you_mean(key, keys())}; there are {known}"
        else:
            yield f"effect {name}, {key}: {said}, got {problem['input']!r}"


def keys() -> tuple[str, ...]:
    """Keys of an effect's table."""
    fields = EffectSettings.model_fields
    return tuple(field.serialization_alias or name for name, field in fields.items())


def _value(kind: EffectKind, name: str, given: Any) -> float:
    known = {p.name: p for p in kind.parameters}
    if name not in known:
        told = ", ".join(describe(parameter) for parameter in kind.parameters)
        raise ValueError(
            f"no such parameter: {name}{did_you_mean(name, known)}; {kind.id} has "
            f"{told or 'no parameters'}, and takes cells, names, planes, from"
        )
    parameter = known[name]
    if isinstance(given, str):
        try:
            value = parse_quantity(given, parameter.unit)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    elif isinstance(given, int | float) and not isinstance(given, bool):
        value = float(given)
    else:
        raise ValueError(f"{name}: {given!r} is no number and no text")
    if not parameter.low <= value <= parameter.high:
        raise ValueError(f"{name}: {value:g} is out of bounds; {describe(parameter)}")
    return value


def describe(parameter: Parameter) -> str:
    """Name a parameter with its bounds and unit: `tau (0 to 10 s)`."""
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.name} ({parameter.low:g} to {parameter.high:g}{unit})"
