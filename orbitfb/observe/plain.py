"""Values as JSON can hold them: no NaN, no numpy, no enumerations."""

import json
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return a value made only of what JSON knows; a number that is not finite becomes None.

    Args:
        value: Any nest of mappings, sequences, numpy arrays and scalars; what is none of these
            becomes its text.
    """
    if isinstance(value, Enum):
        return plain(value.value)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(entry) for entry in value]
    if isinstance(value, Path):
        return str(value)
    return repr(value)


def dumps(value: Any, **options: Any) -> str:
    """Return `value` as JSON that every reader takes.

    Args:
        value: As for `plain`.
        options: As for `json.dumps`.
    """
    return json.dumps(plain(value), allow_nan=False, **options)
