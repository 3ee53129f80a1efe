"""A machine that somebody may forbid to be written to, at any moment."""

from collections.abc import Callable
from dataclasses import replace

from orbitfb.core.errors import WriteError
from orbitfb.core.ports import Machine, Oscillator
from orbitfb.core.signals import Applied, Mask, Reading, Vector
from orbitfb.loop.machines.around import AroundMachine


class GuardedMachine(AroundMachine):
    """Any machine; a write is refused while there is a reason to.

    Meanwhile others may put its setpoints: that is no second controller, as this one puts none.

    Args:
        machine: The machine.
        refusal: Says why it must not be written to now; empty when it may.
    """

    def __init__(self, machine: Machine, refusal: Callable[[], str]) -> None:
        super().__init__(machine)
        self._refusal = refusal

    def read(self, timeout: float) -> Reading:
        """Wait for the next coherent orbit; see `Machine`.

        Args:
            timeout: How long to wait [s].
        """
        reading = super().read(timeout)
        if reading.by_others is None or not self._refusal():
            return reading
        return replace(reading, by_others=None)

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
        return super().write(setpoints, which)


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
