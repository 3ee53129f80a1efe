"""A machine some of whose BPMs do not count, by configuration."""

from dataclasses import replace

from orbitfb.core.ports import Machine
from orbitfb.core.signals import Applied, Channels, Mask, Reading, Vector


class MaskedMachine:
    """Any machine; what masked BPMs read is not valid, whatever they say.

    Args:
        machine: The machine.
        counting: BPMs that count, shape (n,).
    """

    def __init__(self, machine: Machine, counting: Mask) -> None:
        self._machine, self._counting = machine, counting.copy()

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        return self._machine.channels

    def read(self, timeout: float) -> Reading:
        """Wait for the next coherent orbit; see `Machine`.

        Args:
            timeout: How long to wait [s].
        """
        reading = self._machine.read(timeout)
        valid = reading.orbit.valid & self._counting
        return replace(reading, orbit=replace(reading.orbit, valid=valid))

    def setpoints(self) -> Vector:
        """Ask the machine for the absolute setpoints in force, shape (m,) [A]."""
        return self._machine.setpoints()

    def write(self, setpoints: Vector, which: Mask | None = None) -> Applied:
        """Send absolute setpoints; see `Machine`.

        Args:
            setpoints: Shape (m,) [A].
            which: Correctors to put, shape (m,); None: all.
        """
        return self._machine.write(setpoints, which)

    def close(self) -> None:
        """Let go of the machine; setpoints stay where they are."""
        self._machine.close()
