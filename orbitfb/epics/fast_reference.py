"""The reference orbit of a fast feedback beside us: one array per plane, read and written whole."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from orbitfb.core.errors import MachineError, WriteError, few
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Mask, Vector, parts
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.events import Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.records import blank_records
from orbitfb.epics.requests import Getter, Putter
from orbitfb.epics.units import LENGTHS, STATED, LengthUnit, plain_unit

SECTION = "fast_feedback.reference_pvs"


class FastFeedbackSettings(Settings):
    """A fast feedback that is handed our reference orbit while it is closed."""

    reference_pvs: dict[Literal["x", "y"], str] = Field(
        default_factory=dict,
        description="Array PV of its reference, by plane: as many values as the plane has BPMs, in "
        "their order in the places table; empty: `close` is refused while it is closed.",
    )
    unit: LengthUnit | Literal["egu"] = Field(
        default="egu",
        description="Unit of the values; egu: what the PVs state. PVs that state another one (EGU) "
        "are refused.",
    )
    interval: float = Field(
        default=1.0,
        ge=0.1,
        description="Time from one step to the next, at which the step before is read back [s]; "
        "`loop.reference_speed` says how long a step may be.",
    )
    tolerance: float = Field(
        default=1e-8,
        gt=0.0,
        description="Largest difference between what was put and what is read back [m]: above the "
        "rounding of a record in nm, far below what BPMs see.",
    )


class EpicsFastReference:
    """The reference of a fast feedback behind Channel Access.

    Args:
        context: Where its channels live.
        channels: Of the loop.
        settings: Names of the PVs and their unit.
        timeout: How long to wait for an answer [s].

    Attributes:
        which: BPMs whose reference it has, shape (n,).
        group: Its channels.
    """

    def __init__(
        self, context: Context, channels: Channels, settings: FastFeedbackSettings, timeout: float
    ) -> None:
        self._settings = settings
        self.which: Mask = np.zeros(len(channels.bpms), dtype=np.bool_)
        names: list[str] = []
        size = len(channels.bpms)
        for plane, its in parts(channels.planes, size, channels.bpm_counts).items():
            if pv := _of_plane(settings.reference_pvs, plane):
                self.which[its] = True
                names += [f"{pv}.[{element}]" for element in range(its.stop - its.start)]
        self.group = ChannelGroup(context, names, Monitor(blank_records(len(names))))
        self._getter = Getter(context, self.group, timeout)
        self._putter = Putter(context, self.group)
        self._metres = np.ones(len(names))

    def check(self) -> None:
        """Refuse arrays that cannot take our reference, once they are connected.

        Raises:
            MachineError: One may not be written, holds no real numbers, is of another length, or
                states another unit; the message says which.
        """
        group, advice = self.group, f"see {SECTION}, or leave it out"
        wrong = [f"{name} may not be written; ask for write access" for name in group.read_only]
        holds = group.contents
        wrong += [*holds.not_real, *holds.odd_arrays, *holds.not_whole]
        if wrong:
            told = "\n".join(dict.fromkeys(wrong))
            raise MachineError(
                f"the reference of the fast feedback cannot be handed over:\n{told}\nAn array of "
                f"real numbers is needed, one for each BPM of the plane; {advice}."
            )
        stated = [plain_unit(text) for text in self._getter.units()]
        said = self._settings.unit
        units = [unit if said == STATED else said for unit in stated]
        other = [
            f"{name} states {unit or 'no unit'}"
            for name, unit, its in zip(group.names, stated, units, strict=True)
            if its not in LENGTHS or (unit in LENGTHS and unit != its)
        ]
        if other:
            raise MachineError(
                "the reference of the fast feedback cannot be handed over: its unit of length is "
                f"not known, or not {said} (fast_feedback.unit):\n{few(other)}\nName the unit with "
                "fast_feedback.unit, or repair the EGU of the record."
            )
        self._metres = np.array([LENGTHS[its] for its in units])

    def ask(self) -> Vector:
        """Ask for the reference in force, shape (k,) [m], of the BPMs of `which`.

        Raises:
            MachineError: A value is not known.
        """
        values = self._getter.values() * self._metres
        if (silent := ~np.isfinite(values)).any():
            raise MachineError(self._getter.describe(silent))
        return values

    def put(self, values: Vector) -> None:
        """Send a reference.

        Args:
            values: Shape (k,) [m], of the BPMs of `which`.

        Raises:
            WriteError: A channel is away or read-only, or a value is not finite; nothing was sent.
        """
        if not np.isfinite(values).all():
            raise WriteError("a reference that is not finite; nothing was sent")
        self._putter.put(values / self._metres, np.ones(len(values), dtype=np.bool_))


def _of_plane(pvs: Mapping[Literal["x", "y"], str], plane: str) -> str:
    return next((pv for its, pv in pvs.items() if its == plane), "")
