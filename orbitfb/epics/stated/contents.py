"""What the PVs of a group hold: numbers or not, as many as are named or fewer."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from orbitfb.core.names import NamedPv
from orbitfb.core.signals import Mask
from orbitfb.epics.libca import DBR_DOUBLE, DBR_FLOAT

TEXT, INTEGER, STRUCTURE = 0, 5, -1
FIELD_TYPES = {
    TEXT: "text",
    1: "a short integer",
    3: "an enumeration",
    4: "bytes",
    INTEGER: "an integer",
    STRUCTURE: "a structure without a value that is known here",
}
"""Native types that hold no real number, by their number in db_access.h; pvAccess has structures
besides."""
REAL, WHOLE = (DBR_FLOAT, DBR_DOUBLE), (1, INTEGER)
"""Native types that hold real numbers, and whole ones. An int64 is a real number to Channel
Access: that its record rounds is not to be seen there."""


class Contents:
    """What those that are connected hold now.

    Args:
        pvs: The PVs of the group.
        names: Count of their names.
        kinds: Gives native types by number of the PV.
        sizes: Gives counts of values by number of the PV.
    """

    def __init__(
        self,
        pvs: Sequence[NamedPv],
        names: int,
        kinds: Callable[[], Mapping[int, int]],
        sizes: Callable[[], Mapping[int, int]],
    ) -> None:
        self._pvs, self._names, self._kinds, self._sizes = pvs, names, kinds, sizes

    @property
    def not_real(self) -> tuple[str, ...]:
        """The PVs that hold no real number, each with what it holds."""
        return self._told_of_other(REAL)

    @property
    def not_numbers(self) -> tuple[str, ...]:
        """The PVs that hold no number, each with what it holds."""
        return self._told_of_other((*REAL, *WHOLE))

    @property
    def odd_arrays(self) -> tuple[str, ...]:
        """The arrays that hold no numbers, or fewer values than are named, each with what."""
        kinds, told = self._kinds(), []
        for number, size in self._sizes().items():
            pv, kind = self._pvs[number], kinds.get(number, DBR_DOUBLE)
            if pv.elements is not None and kind not in (*REAL, *WHOLE):
                told.append(self._what(number, kind))
            elif size < pv.length:
                told.append(f"{pv.name} holds {size} values, and element {pv.length - 1} is named")
        return tuple(told)

    @property
    def not_whole(self) -> tuple[str, ...]:
        """The arrays that hold values without a name, each with how many."""
        return tuple(
            f"{pv.name} holds {size} values, of which {len(pv.places)} are named"
            for number, size in self._sizes().items()
            if (pv := self._pvs[number]).elements is not None and size != len(pv.places)
        )

    @property
    def whole(self) -> Mask:
        """Names whose PV holds whole numbers only, shape (k,)."""
        mask = np.zeros(self._names, dtype=np.bool_)
        for number, kind in self._kinds().items():
            mask[self._pvs[number].places] = kind in WHOLE
        return mask

    def _told_of_other(self, kinds: tuple[int, ...]) -> tuple[str, ...]:
        return tuple(
            self._what(number, kind) for number, kind in self._kinds().items() if kind not in kinds
        )

    def _what(self, number: int, kind: int) -> str:
        return f"{self._pvs[number].name} is {FIELD_TYPES.get(kind, f'of type {kind}')}"
