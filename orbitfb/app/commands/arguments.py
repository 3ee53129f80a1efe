"""What a request may ask for: numbers, switches and references, checked as a whole."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Mask, Vector


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def number(request: Mapping[str, Any], key: str, low: float, high: float) -> float:
    """Read a number within limits.

    Raises:
        ControlError: It is missing, none, or beyond the limits.
    """
    value = request.get(key)
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise ControlError(f"{key} must be a number from {low:g} to {high:g}, not {value!r}")
    return float(value)


def whole_number(request: Mapping[str, Any], key: str, low: int, high: int) -> int:
    """Read a whole number within limits.

    Raises:
        ControlError: It is missing, none, or beyond the limits.
    """
    value = number(request, key, low, high)
    if value != int(value):
        raise ControlError(f"{key} must be a whole number, not {value:g}")
    return int(value)


def plane_of(request: Mapping[str, Any], planes: Iterable[str]) -> str:
    """Read a plane.

    Raises:
        ControlError: It is none of these.
    """
    plane, known = request.get("plane"), tuple(planes)
    if plane not in known:
        raise ControlError(f"no plane {plane!r}; the loop has {', '.join(known)}")
    return str(plane)


def switches(request: Mapping[str, Any], size: int) -> Mask:
    """Read what is enabled, shape (size,).

    Raises:
        ControlError: It is missing, or not so many truth values.
    """
    values = request.get("enabled")
    if (
        not isinstance(values, list)
        or len(values) != size
        or not all(isinstance(value, bool) for value in values)
    ):
        raise ControlError(f"enabled must be {size} truth values, one per device and plane")
    return np.array(values, dtype=np.bool_)


def reference_of(values: Sequence[Any], size: int, limit: float) -> Vector:
    """Read a reference orbit, shape (size,) [m].

    Args:
        values: As asked for.
        size: BPMs, per plane.
        limit: Largest position [m].

    Raises:
        ControlError: These are not so many numbers, or one is beyond the limit.
    """
    if len(values) != size or not all(_is_number(value) for value in values):
        raise ControlError(f"a reference is {size} numbers [m], one per BPM and plane")
    reference = np.array(values, dtype=np.float64)
    if not (np.abs(reference) <= limit).all():
        worst = float(np.nanmax(np.abs(reference)))
        raise ControlError(
            f"the reference goes up to {worst * 1e3:.4g} mm, or is not finite; the limit is "
            f"{limit * 1e3:g} mm (panel.reference_limit)"
        )
    reference.setflags(write=False)
    return reference
