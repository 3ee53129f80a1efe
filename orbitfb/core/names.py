"""Names of PVs: those that all layers share, elements of arrays, and what is not Channel Access.

`PV.[17]` is element 17 of the array in `PV`, counted from 0: so EPICS base spells one element of an
array (`caget 'PV.[17]'`). Here all elements of one array that are named are read and written
together, by one channel: they have one time stamp.

`pva://PV` is a PV that is reached over pvAccess; every other one is of Channel Access.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CURRENT_PV = "SR:C03-BI{DCCT:1}I:Real-I"
"""Stored current [mA]."""

RF_PV = "RF{Osc:1}Freq:SP"
"""Setpoint of the RF frequency [Hz]."""

RF_READBACK_PV = "RF{Osc:1}Freq:I"
"""Readback of the RF frequency [Hz]."""
LEASE_PV = "SR:FB{Lease:%}Owner-SP"
"""Who writes to a plane of the machine; % stands for the plane, X or Y."""

RF_FREQUENCY, RF_READBACK, RF_STEP = "rf_frequency", "rf_readback", "rf_step"
"""Slow channels of the RF: its setpoint and its readback, and by how much the loop changed it since
the orbit before [Hz]."""

RF_TOLERANCE = 0.1
"""Change of the RF setpoint that counts as one, the default of `rf.tolerance` [Hz]."""

FAST_FEEDBACK = "fast_feedback_closed"
"""Slow channel that the loop adds beside a fast feedback: 0 while that is open, else 1."""

PVA = "pva://"
"""Begins the name of a PV that is reached over pvAccess, as Phoebus spells it."""

_ELEMENT = re.compile(r"(?P<pv>.+?)(?:\.VAL|\.)\[(?P<index>\d{1,6})\]")


@dataclass(frozen=True, slots=True, eq=False)
class NamedPv:
    """A PV, and which names are its values.

    Args:
        name: Of the PV.
        places: Which of the names they are, shape (k,); of a scalar one.
        elements: Which element each of them is, shape (k,); None: the PV is a scalar.
    """

    name: str
    places: NDArray[np.intp]
    elements: NDArray[np.intp] | None = None

    @property
    def length(self) -> int:
        """Values that it must have at least."""
        return 1 if self.elements is None else int(self.elements.max()) + 1

    @property
    def over_pva(self) -> bool:
        """Whether it is reached over pvAccess."""
        return self.name.startswith(PVA)

    @property
    def served(self) -> str:
        """Its name at its server."""
        return self.name.removeprefix(PVA)

    @property
    def is_whole(self) -> bool:
        """Whether each of the first `length` values has a name, as whoever writes it must know."""
        return len(self.places) == self.length


def named_pvs(names: Sequence[str]) -> tuple[NamedPv, ...]:
    """Gather names into PVs, in the order in which they come first.

    Args:
        names: PVs, or elements of arrays; each of them once.
    """
    found: dict[tuple[str, bool], tuple[list[int], list[int]]] = {}
    for place, name in enumerate(names):
        match = _ELEMENT.fullmatch(name)
        key = (name, False) if match is None else (match["pv"], True)
        places, elements = found.setdefault(key, ([], []))
        places.append(place)
        elements.append(0 if match is None else int(match["index"]))
    pvs: list[NamedPv] = []
    for (name, is_array), (places, elements) in found.items():
        if is_array:
            pvs.append(NamedPv(name, np.array(places), np.array(elements)))
        else:
            pvs += [NamedPv(name, np.array([place])) for place in places]
    return tuple(pvs)


def any_over_pva(names: Iterable[str]) -> bool:
    """Tell whether one of these PVs is reached over pvAccess."""
    return any(name.startswith(PVA) for name in names)
