"""A machine around another one: what it does not change it passes on."""

from orbitfb.core.ports import Machine
from orbitfb.core.signals import Applied, Channels, Mask, Reading, Vector


class AroundMachine:
    """Any machine, as it is.

    Args:
        machine: The machine.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        return self._machine.channels

    def read(self, timeout: float) -> Reading:
        """Wait for the next coherent orbit; see `Machine`.

        Args:
            timeout: How long to wait [s].
        """
        return self._machine.read(timeout)

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
