"""Units of PVs: what a record says of its own (EGU), against what the configuration says.

A record that states no unit, or one that is not known here, contradicts nothing.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.safety.verdict import name_some

LengthUnit = Literal["m", "mm", "um", "nm"]
STATED = "egu"
"""Stands for a unit: that which the record itself states."""
LENGTHS: dict[str, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
"""Units of BPM readings [m]."""

AMPERES: dict[str, float] = {"a": 1.0, "ma": 1e-3, "ua": 1e-6, "ka": 1e3}
"""Units of currents [A]. No magnet and no beam has a megaampere: "MA" is a milliampere."""

_SAME = {
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "millimeter": "mm",
    "millimetre": "mm", "micron": "um", "microns": "um", "micrometer": "um", "micrometre": "um",
    "nanometer": "nm", "nanometre": "nm", "amp": "a", "amps": "a", "ampere": "a", "amperes": "a",
    "milliamp": "ma", "milliamps": "ma",
}  # fmt: skip
_MICRO = ("µ", "μ")
"""The micro sign and the Greek letter look alike."""


def plain_unit(text: str) -> str:
    """Give a unit as it is written here: `um` for µm or microns, `ma` for mA.

    Args:
        text: As a record or a person writes it.
    """
    unit = text.strip().casefold()
    for sign in _MICRO:
        unit = unit.replace(sign.casefold(), "u")
    return _SAME.get(unit, unit)


def metres_of(
    names: Sequence[str],
    stated: Sequence[str],
    said: Sequence[str],
    usual: str,
    here: Mask | None = None,
) -> tuple[NDArray[np.float64], str]:
    """Give the length of each BPM's unit, and what of it is contradicted.

    Args:
        names: The n PVs.
        stated: Their EGU, n texts; empty where one is away.
        said: What the places table says of each, n texts, empty: nothing; or nothing at all.
        usual: `epics.bpm_unit`, for those of which the table says nothing.
        here: Those that are connected, shape (n,); None: all.

    Returns:
        Shape (n,) [m], NaN where it is not known, and a sentence; empty when nothing is wrong.
    """
    plain = [plain_unit(text) for text in stated]
    units = [one or usual for one in (said or ("",) * len(names))]
    metres = np.array(
        [LENGTHS.get(egu if unit == STATED else unit, np.nan)
         for unit, egu in zip(units, plain, strict=True)]
    )  # fmt: skip
    other = np.array(
        [egu in LENGTHS and unit != STATED and egu != unit
         for unit, egu in zip(units, plain, strict=True)], dtype=np.bool_
    )  # fmt: skip
    if other.any():
        return metres, _contradiction(names, plain, units, other)
    unknown = np.isnan(metres) if here is None else np.isnan(metres) & here
    if unknown.any():
        return metres, (
            f"{np.count_nonzero(unknown)} of {len(names)} BPM PVs state no unit of length (EGU), "
            f'and epics.bpm_unit = "{STATED}" says nothing of them: '
            f"{name_some(unknown, tuple(names))}; give them one in column unit of the places table"
        )
    return metres, ""


def _contradiction(
    names: Sequence[str], plain: Sequence[str], units: Sequence[str], other: Mask
) -> str:
    which = [int(index) for index in np.flatnonzero(other)]
    found, told = sorted({plain[i] for i in which}), sorted({units[i] for i in which})
    advice = (
        f'set epics.bpm_unit = "{found[0]}"'
        if other.all() and len(found) == 1
        else f'say it in column unit of the places table, or set epics.bpm_unit = "{STATED}"'
    )
    return (
        f"{len(which)} of {len(names)} BPM PVs state {' and '.join(found)} as their unit (EGU), "
        f"the configuration says {' and '.join(told)} (epics.bpm_unit, or column unit of the "
        f"places table): {name_some(other, tuple(names))}; {advice}"
    )


def corrector_contradiction(names: Sequence[str], stated: Sequence[str]) -> str:
    """Say which setpoints or readbacks state another unit than A; empty when none does.

    Args:
        names: The m PVs.
        stated: Their EGU, m texts.
    """
    other = np.array([AMPERES.get(plain_unit(text), 1.0) != 1.0 for text in stated], dtype=np.bool_)
    if not other.any():
        return ""
    first = stated[int(np.flatnonzero(other)[0])]
    return (
        f"{np.count_nonzero(other)} of {len(names)} corrector PVs state {first} as their unit "
        f"(EGU), orbitfb reads and writes A: {name_some(other, tuple(names))}; name PVs in A"
    )
