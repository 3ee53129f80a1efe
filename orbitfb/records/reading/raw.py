"""The arrays of a record as they lie in a file, before anything is believed of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RecordError
from orbitfb.core.signals import Vector

LARGEST_RECORD = 2 * 2**30
"""Most that is read into memory, if nothing else is said [bytes]."""

MOST_ARRAYS = 256
MOST_DEVICES = 20_000
LONGEST_NAME = 256
LONGEST_TEXT = 2**20

NAMES = ("bpm_names", "corr_names")
TEXTS = (*NAMES, "meta")
VECTORS = ("orbit", "next_orbit", "reference")
CURRENTS = ("action", "setpoint", "readback", "dither")
NUMBERS = ("t", *VECTORS, *CURRENTS, "model_R", "current", "rf")
_ALIASES = {
    "readbacks": "readback",
    "setpoints": "setpoint",
    "actions": "action",
    "golden": "reference",
    "reference_orbit": "reference",
    "beam_current": "current",
    "rf_frequency": "rf",
    "time": "t",
    "r": "model_R",
    "model_r": "model_R",
    "corrector_names": "corr_names",
}


@dataclass(frozen=True, slots=True)
class Raw:
    """Arrays of a file by their canonical names.

    Args:
        path: The file.
        numbers: Arrays of finite or not finite float64.
        texts: Lists of texts; `meta` is a list of one.
        units: What the file says beside an array of its unit.
    """

    path: Path
    numbers: Mapping[str, Vector]
    texts: Mapping[str, tuple[str, ...]]
    units: Mapping[str, str] = field(default_factory=dict[str, str])

    def wrong(self, array: str, problem: str, advice: str) -> RecordError:
        """Make the error about one array."""
        return RecordError(f"{self.path}: array '{array}' {problem}; {advice}")


def canonical(name: str) -> str:
    """Give the name under which an array is known."""
    return _ALIASES.get(name.lower(), name)


def check_kind(path: Path, name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> bool:
    """Refuse what is neither numbers nor names, by its header alone.

    Returns:
        Whether to read it: arrays of unknown names are slow channels, or ignored.

    Raises:
        RecordError: The type or the number of dimensions cannot be.
    """

    def wrong(problem: str, advice: str) -> RecordError:
        return RecordError(f"{path}: array '{name}' {problem}; {advice}")

    if dtype.hasobject:
        raise wrong(
            "holds pickled Python objects, which are never opened (they could run code)",
            "save numbers as float64 and names as fixed-width text",
        )
    if canonical(name) in TEXTS:
        if dtype.kind not in "US" or len(shape) > 1:
            raise wrong(
                f"has type {dtype} and shape {shape}, text was expected",
                "save a list of names (or, for meta, one JSON text)",
            )
        width = dtype.itemsize // (4 if dtype.kind == "U" else 1)
        longest = LONGEST_TEXT if canonical(name) == "meta" else LONGEST_NAME
        if width > longest:
            raise wrong(f"has texts of {width} characters", f"at most {longest} are read")
        if len(shape) == 1 and shape[0] > MOST_DEVICES:
            raise wrong(f"has {shape[0]} texts", f"at most {MOST_DEVICES} devices are read")
        if canonical(name) == "meta" and shape not in ((), (1,)):
            raise wrong(f"has shape {shape}", "save it as one JSON text")
    elif canonical(name) not in NUMBERS:
        return dtype.kind in "fiu" and len(shape) == 1
    elif dtype.kind not in "fiu" or len(shape) > 2:
        raise wrong(
            f"has type {dtype} and shape {shape}, numbers in one or two dimensions were expected",
            "save real numbers (float64), rows in the first dimension",
        )
    return True


def sort_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> Raw:
    """Sort arrays that passed `check_kind` into numbers and texts.

    Raises:
        RecordError: A text is no UTF-8, or two arrays mean the same.
    """
    numbers: dict[str, Vector] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for given, array in arrays.items():
        name = canonical(given)
        if name in numbers or name in texts:
            raise RecordError(
                f"{path}: array '{given}' is there twice, under two spellings of '{name}'; leave "
                "one out"
            )
        if name in TEXTS:
            texts[name] = _texts(path, given, array)
        else:
            numbers[name] = np.ascontiguousarray(array, dtype=np.float64)
    return Raw(path, numbers, texts)


def _texts(path: Path, name: str, array: NDArray[Any]) -> tuple[str, ...]:
    found: list[str] = []
    for row, item in enumerate(np.atleast_1d(array)):
        try:
            text = item.decode() if isinstance(item, bytes) else str(item)
            text.encode()
        except UnicodeError as error:
            raise RecordError(
                f"{path}: array '{name}', row {row}: no text in UTF-8; correct it"
            ) from error
        found.append(text)
    return tuple(found)
