"""What the soft IOC needs of a simulated ring. `orbitfb.physics.plant.Plant` has it."""

from typing import Protocol

from orbitfb.core.signals import Channels, Vector


class RingState(Protocol):
    """What one tick of a simulated ring shows, all SI."""

    @property
    def reading(self) -> Vector:
        """What the BPMs say, shape (n,) [m]."""
        ...

    @property
    def true_orbit(self) -> Vector:
        """Where the beam is, shape (n,) [m]."""
        ...

    @property
    def readback(self) -> Vector:
        """What the power supplies deliver, shape (m,) [A]."""
        ...


class SimulatedRing(Protocol):
    """A ring that advances by one tick when it is told the setpoints."""

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        ...

    @property
    def tick(self) -> int:
        """Ticks made so far."""
        ...

    def step(self, setpoints: Vector, frequency_change: float = 0.0) -> RingState:
        """Advance by one tick.

        Args:
            setpoints: Absolute, shape (m,) [A].
            frequency_change: RF frequency beyond that at the start [Hz].
        """
        ...

    def kick(self, rms: float) -> None:
        """Kick the beam at random, so that the orbit moves by this rms [m] at the next tick."""
        ...
