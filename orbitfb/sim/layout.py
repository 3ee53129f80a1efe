"""Which PVs there are, in which order, with which units and limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.names import CURRENT_PV, RF_PV, RF_READBACK_PV, named_pvs
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.epics.units import LENGTHS
from orbitfb.sim.ring import RingState
from orbitfb.sim.settings import SimSettings

TRUE_RMS_PV = "SR:SIM{Ring}Rms:True-I"
TICK_PV = "SR:SIM{Ring}Tick-I"
KICK_PV = "SR:SIM{Ring}Kick-SP"
STORED_PV = "SR:SIM{Ring}Current-SP"

MILLI = 1.0e3
"""From m to mm and from A to mA."""

_MOST_CURRENT = 500.0

Range = tuple[float, float]
NO_RANGE: Range = (0.0, 0.0)
"""Equal ends mean no limit, as in EPICS."""


@dataclass(frozen=True, slots=True)
class PvSpec:
    """One PV and its metadata, in the PV's own units.

    Args:
        name: The PV.
        units: At most 7 characters.
        precision: Digits after the point on a screen.
        display: Range of a slider or plot.
        warning: LOW and HIGH (MINOR).
        alarm: LOLO and HIHI (MAJOR).
        drive: Range outside which a write is refused.
        initial: Value before anybody writes.
    """

    name: str
    units: str
    precision: int
    display: Range = NO_RANGE
    warning: Range = NO_RANGE
    alarm: Range = NO_RANGE
    drive: Range = NO_RANGE
    initial: float = 0.0


@dataclass(frozen=True, slots=True)
class Layout:
    """All PVs of a ring.

    Args:
        readings: What every tick publishes, in the order in which clients see it: readbacks and
            BPMs in the order of the channels, stored current, RF, true rms, tick. The last BPM
            completes an orbit whose readbacks are there already: clients need not wait again.
        setpoints: Setpoints in the order of the channels [A], then that of the RF [Hz].
        kick: The random kick [mm].
        stored: The stored current that the simulated ring is to have [mA].
        rf_frequency: What the oscillator shows at the start [Hz].
        planes: x, y or xy.
        read_back: Correctors that have a readback, shape (m,).
        metres: Unit of each reading, shape (n,) [m].
    """

    readings: tuple[PvSpec, ...]
    setpoints: tuple[PvSpec, ...]
    kick: PvSpec
    stored: PvSpec
    rf_frequency: float
    planes: str
    read_back: Mask
    metres: Vector

    def __len__(self) -> int:
        names = [spec.name for spec in (*self.readings, *self.setpoints, *self.knobs)]
        return len(named_pvs(names))

    @property
    def correctors(self) -> int:
        """How many of the setpoints are those of correctors."""
        return len(self.setpoints) - 1

    @property
    def knobs(self) -> tuple[PvSpec, ...]:
        """What a tester turns; no machine has them."""
        return self.kick, self.stored

    def values(
        self, state: RingState, tick: int, stored: float | None = None, rf: float | None = None
    ) -> Vector:
        """Give the values of `readings` at a tick, in the units of the PVs.

        Args:
            state: Of the ring.
            tick: Its number.
            stored: Stored current [mA]; None: what it is at the start.
            rf: RF frequency [Hz]; None: what it is at the start.
        """
        true_rms = float(np.sqrt(np.mean(np.square(state.true_orbit)))) * MILLI
        current = self.stored.initial if stored is None else stored
        slow = (current, self.rf_frequency if rf is None else rf, true_rms, float(tick))
        readback = state.readback[self.read_back]
        return np.concatenate((readback, state.reading / self.metres, slow))


_DIGITS = {"m": 8, "mm": 5, "um": 2, "nm": 0}
"""Digits after the point of a reading: 10 nm, and whole nanometres."""
_SCREEN = 5e-3
"""Range of a reading on a screen [m]."""


def _reading(name: str, unit: str, settings: SimSettings) -> PvSpec:
    """Give the PV of a BPM in its unit."""

    def both(limit: float) -> Range:
        return (-limit / LENGTHS[unit], limit / LENGTHS[unit])

    return PvSpec(
        name,
        unit,
        _DIGITS[unit],
        display=both(_SCREEN),
        warning=both(settings.orbit_warning),
        alarm=both(settings.orbit_alarm),
    )


def check_served(channels: Channels, settings: SimSettings) -> None:
    """Refuse arrays that cannot be served.

    Args:
        channels: Names of the PVs.
        settings: Of the soft IOC.

    Raises:
        RingError: An array has elements without a name, or of several kinds; arrays are to be
            served by `sim.plain`; or a scalar over pvAccess.
    """
    kinds = (channels.orbit_pvs, channels.setpoint_pvs, tuple(filter(None, channels.readback_pvs)))
    pvs = [pv for names in kinds for pv in named_pvs(names)]
    for pv in pvs:
        if pv.over_pva and pv.elements is None:
            raise RingError(
                f"{pv.name} is a scalar over pvAccess, of which the simulated ring serves none; "
                f"name an element of an array, {pv.name}.[0], or a PV of Channel Access"
            )
    arrays = [pv for pv in pvs if pv.elements is not None]
    names = [pv.name for pv in arrays]
    for pv in arrays:
        if not pv.is_whole:
            raise RingError(
                f"{pv.name} has {pv.length} elements, of which {len(pv.places)} stand in the "
                "places table; name each of them, counted from 0"
            )
        if names.count(pv.name) > 1:
            raise RingError(
                f"{pv.name} stands for several of readings, setpoints and readbacks in the places "
                "table; give each an array of its own"
            )
    if arrays and settings.plain:
        raise RingError(
            f"sim.plain serves no array, and {names[0]} is one; leave sim.plain out (--plain)"
        )


def lay_out(channels: Channels, settings: SimSettings) -> Layout:
    """Name every PV of a ring and give it its limits."""

    def both(limit: float) -> Range:
        return (-limit, limit)

    drive = both(settings.corrector_limit)
    warning = both(settings.corrector_limit * settings.corrector_warning)
    rf = settings.rf_frequency or 0.0
    rf_range = (rf - settings.rf_range, rf + settings.rf_range)
    most = (0.0, max(_MOST_CURRENT, settings.stored_current * MILLI))

    def ammeters(names: Sequence[str], drive_range: Range) -> tuple[PvSpec, ...]:
        return tuple(
            PvSpec(name, "A", 5, display=drive, warning=warning, alarm=drive, drive=drive_range)
            for name in names
        )

    units = channels.bpm_units or ("",) * len(channels.orbit_pvs)
    bpms = tuple(
        _reading(name, unit or "mm", settings)
        for name, unit in zip(channels.orbit_pvs, units, strict=True)
    )
    slow = (
        PvSpec(CURRENT_PV, "mA", 3, display=most),
        PvSpec(RF_READBACK_PV, "Hz", 3, display=rf_range),
        PvSpec(TRUE_RMS_PV, "mm", 6, display=(0.0, 1.0)),
        PvSpec(TICK_PV, "", 0),
    )
    return Layout(
        readings=(*ammeters(list(filter(None, channels.readback_pvs)), NO_RANGE), *bpms, *slow),
        setpoints=(
            *ammeters(channels.setpoint_pvs, drive),
            PvSpec(RF_PV, "Hz", 3, display=rf_range, drive=rf_range, initial=rf),
        ),
        kick=PvSpec(KICK_PV, "mm", 3, drive=(0.0, settings.kick_limit * MILLI)),
        stored=PvSpec(
            STORED_PV, "mA", 3, display=most, drive=most, initial=settings.stored_current * MILLI
        ),
        rf_frequency=rf,
        planes=channels.planes,
        metres=np.array([LENGTHS[unit or "mm"] for unit in units]),
        read_back=np.array([bool(name) for name in channels.readback_pvs], dtype=np.bool_),
    )
