"""Units of PVs: what a record says of its own (EGU), against what the configuration says.

A record that states no unit, or one that is not known here, contradicts nothing.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from orbitfb.safety.verdict import name_some

LengthUnit = Literal["m", "mm", "um", "nm"]
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


def bpm_contradiction(names: Sequence[str], stated: Sequence[str], unit: str) -> str:
    """Say which BPM PVs state another unit than `epics.bpm_unit`; empty when none does.

    Args:
        names: The n PVs.
        stated: Their EGU, n texts.
        unit: As configured.
    """
    plain = [plain_unit(text) for text in stated]
    other = np.array([one in LENGTHS and one != unit for one in plain], dtype=np.bool_)
    if not other.any():
        return ""
    found = sorted({one for one, is_other in zip(plain, other, strict=True) if is_other})
    advice = (
        f'set epics.bpm_unit = "{found[0]}"'
        if other.all() and len(found) == 1
        else "they must all be of one unit"
    )
    return (
        f"{np.count_nonzero(other)} of {len(names)} BPM PVs state {' and '.join(found)} as their "
        f'unit (EGU), epics.bpm_unit says "{unit}": {name_some(other, tuple(names))}; {advice}'
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
