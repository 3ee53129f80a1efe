"""What the configuration's validation refused, each in a sentence with the place it came from."""

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any

from pydantic_core import ErrorDetails

from orbitfb.config.tree import AppConfig
from orbitfb.core.near_names import near_names

_FORMS = {
    "bool_type": "write true or false",
    "tuple_type": 'write a list, as in ["A", "B"]',
    "list_type": 'write a list, as in ["A", "B"]',
    "dict_type": 'write a table, as in { name = "A" }',
}
"""What to write, where a value is of the wrong type."""
_LONGEST_SHOWN = 200


def refusals(problems: Iterable[ErrorDetails], origins: Mapping[str, str]) -> list[str]:
    """Tell every problem once.

    Args:
        problems: As pydantic has them.
        origins: Where each key was set, by dotted path.
    """
    return _once([_explain(problem, origins) for problem in problems])


def _explain(problem: ErrorDetails, origins: Mapping[str, str]) -> str:
    location = [str(part) for part in problem["loc"]]
    dotted = ".".join(location) or "the configuration"
    above = (".".join(location[:end]) for end in range(len(location), 0, -1))
    below = (key for key in origins if key.startswith(f"{dotted}."))
    origin = next((origins[key] for key in chain(above, below) if key in origins), "default")
    if problem["type"] == "extra_forbidden":
        return f"{dotted}: no such key ({origin}){_did_you_mean(location)}"
    its, where = (origin, f"key {dotted}") if origin.startswith("--") else (dotted, origin)
    form = f"; {_FORMS[problem['type']]}" if problem["type"] in _FORMS else ""
    return f"{its}: {problem['msg']}, got {_short(problem['input'])} ({where}){form}"


def _once(problems: list[str]) -> list[str]:
    """Leave out what an option that sets several keys has wrong a second time."""
    first: dict[str, str] = {}
    for problem in problems:
        first.setdefault(problem.rpartition(" (")[0] if problem.startswith("--") else problem,
                         problem)  # fmt: skip
    return list(first.values())


def _short(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= _LONGEST_SHOWN else f"{shown[:_LONGEST_SHOWN]}…"


def _did_you_mean(location: list[str]) -> str:
    model: Any = AppConfig
    for part in location[:-1]:
        field = getattr(model, "model_fields", {}).get(part)
        model = field.annotation if field else None
    known = list(getattr(model, "model_fields", {}))
    if near := near_names(location[-1], known, most=1):
        return f"; did you mean {near[0]}?"
    return f"; known here: {', '.join(known)}" if known else ""
