"""Values that the loop makes anew at every tick, from those before."""

import dataclasses
from typing import Any, TypeVar, cast

T = TypeVar("T")


def replace(value: T, /, **new: Any) -> T:
    """Do as `dataclasses.replace` does, at a price that does not grow with the count of fields.

    A tick changes the memory of the loop some twenty times. A value that keeps its fields in a dict
    is copied as a whole; one with slots is built field by field.

    Args:
        value: A dataclass; one without slots has no `__post_init__`, which is not called.
        new: Fields that differ.

    Raises:
        TypeError: It has no such field.
    """
    fields = getattr(value, "__dict__", None)
    if fields is None:
        return cast(T, dataclasses.replace(cast(Any, value), **new))
    if not new.keys() <= fields.keys():
        unknown = ", ".join(sorted(new.keys() - fields.keys()))
        raise TypeError(f"{type(value).__name__} has no field {unknown}")
    after: T = object.__new__(type(value))
    after.__dict__.update(fields, **new)
    return after
