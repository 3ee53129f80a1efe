"""A machine some of whose BPMs do not count, by configuration."""

from dataclasses import replace

from orbitfb.core.ports import Machine
from orbitfb.core.signals import Mask, Reading
from orbitfb.loop.machines.around import AroundMachine


class MaskedMachine(AroundMachine):
    """Any machine; what masked BPMs read is not valid, whatever they say.

    Args:
        machine: The machine.
        counting: BPMs that count, shape (n,).
    """

    def __init__(self, machine: Machine, counting: Mask) -> None:
        super().__init__(machine)
        self._counting = counting.copy()

    def read(self, timeout: float) -> Reading:
        """Wait for the next coherent orbit; see `Machine`.

        Args:
            timeout: How long to wait [s].
        """
        reading = super().read(timeout)
        valid = reading.orbit.valid & self._counting
        return replace(reading, orbit=replace(reading.orbit, valid=valid))
