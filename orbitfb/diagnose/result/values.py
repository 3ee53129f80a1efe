"""Numbers of a diagnosis in the form of JSON, and the base class of its parts."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

_DIGITS = 7
"""Significant digits that are kept: more than any estimate from a record has."""


def number(value: Any) -> float | None:
    """Make a number of JSON; what is not finite becomes None, "not resolved".

    Args:
        value: A number of any kind, None.

    Returns:
        Rounded to 7 significant digits.
    """
    if value is None:
        return None
    plain = float(value)
    return float(f"{plain:.{_DIGITS - 1}e}") if math.isfinite(plain) else None


def numbers(values: Any) -> tuple[float | None, ...]:
    """Make a row of numbers of JSON from an array or a sequence, shape (k,)."""
    return tuple(number(value) for value in np.asarray(values, dtype=float).tolist())


def rows(values: Any) -> tuple[tuple[float | None, ...], ...]:
    """Make a table of numbers of JSON from an array or nested sequences, shape (k, l)."""
    return tuple(numbers(row) for row in values)


def _before(value: Any) -> Any:
    # text and booleans are left as they are, so that pydantic refuses or takes them by its rules
    plain = isinstance(value, int | float | np.floating | np.integer)
    return number(value) if plain and not isinstance(value, bool) else value


def _sequence_before(value: Any) -> Any:
    return numbers(value) if isinstance(value, np.ndarray) else value


def _table_before(value: Any) -> Any:
    return rows(value) if isinstance(value, np.ndarray) else value


def _frozen(value: Sequence[Any]) -> Sequence[Any]:
    return tuple(value)


Number = Annotated[float | None, BeforeValidator(_before)]
"""A finite number, or null: not resolved or not computed. NaN and infinities become null."""
Numbers = Annotated[Sequence[Number], BeforeValidator(_sequence_before), AfterValidator(_frozen)]
"""Numbers in their order, null where one is not resolved; an array may be given."""
Table = Annotated[Sequence[Numbers], BeforeValidator(_table_before), AfterValidator(_frozen)]
"""Rows of numbers; an array may be given."""


class Part(BaseModel):
    """A frozen part of a diagnosis; it refuses unknown keys and numbers that JSON lacks."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )
