"""A machine that somebody may forbid to be written to, at any moment."""

from collections.abc import Callable

from orbitfb.core.errors import WriteError
from orbitfb.core.ports import Machine, Oscillator
from orbitfb.core.signals import Applied, Channels, Mask, Reading, Vector


class GuardedMachine:
    """Any machine; a write is refused while there is a reason to.

    Args:
        machine: The machine.
        refusal: Says why it must not be written to now; empty when it may.
    """

    def __init__(self, machine: Machine, refusal: Callable[[], str]) -> None:
        self._machine, self._refusal = machine, refusal

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

        Raises:
            WriteError: There is a reason not to, or the machine refuses.
        """
        if reason := self._refusal():
            raise WriteError(f"{reason}; nothing was sent")
        return self._machine.write(setpoints, which)

    def close(self) -> None:
        """Let go of the machine; setpoints stay where they are."""
        self._machine.close()


class GuardedOscillator:
    """Any RF; a put is refused while there is a reason to.

    Args:
        oscillator: The RF.
        refusal: Says why it must not be written to now; empty when it may.
    """

    def __init__(self, oscillator: Oscillator, refusal: Callable[[], str]) -> None:
        self._oscillator, self._refusal = oscillator, refusal

    @property
    def limits(self) -> tuple[float, float]:
        """Drive limits that the machine states, low and high [Hz]; NaN: none."""
        return self._oscillator.limits

    def put(self, frequency: float) -> None:
        """Send a setpoint [Hz].

        Raises:
            WriteError: There is a reason not to, or the machine refuses.
        """
        if reason := self._refusal():
            raise WriteError(f"{reason}; nothing was sent")
        self._oscillator.put(frequency)
