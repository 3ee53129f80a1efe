"""What healthy errors do together that is not the sum of what each does alone.

A gradient error changes how the orbit goes from the next one, and a gain how far a corrector moves
it. A closed bump is the difference of orbits a hundred times as large as it: errors of one per cent
of these are known from the record and small, but one per cent of such an error is still as large as
the noise of a reading. Errors that are taken to add up leave it over, as a gap that a healthy ring
does not have; so they are added up around those that the record shows.
"""

from dataclasses import replace

import numpy as np

from orbitfb.physics.optics import Matrix, green
from orbitfb.records.layout import ChannelPlane, HealthyErrors, Layout
from orbitfb.records.record import Record


class Bent:
    """Response of a ring that has healthy errors, and what further ones change of it.

    Args:
        layout: Devices and ring; the errors are its `healthy`, none where it has none.

    Attributes:
        response: With these gradients, shape (n, m) [m/A].
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.response = layout.response
        if (errors := layout.healthy) is not None:
            changes = [
                layout.orbit_per_kick("QUAD", plane) * kick @ self._orbit_at(plane)
                for plane, kick in errors.kicks.items()
            ]
            self.response = layout.response + sum(changes)

    def orbit_per_kick(self, plane: ChannelPlane) -> Matrix:
        """Orbit at the BPMs per kick at every quadrupole, shape (n, q) [m/rad]."""
        straight = self._layout.orbit_per_kick("QUAD", plane)
        if (errors := self._layout.healthy) is None:
            return straight
        between = green(self._layout.known_ring, "QUAD", "QUAD", plane)
        return straight + straight * errors.kicks[plane] @ self._again(plane, between)

    def orbit_at(self, plane: ChannelPlane) -> Matrix:
        """Orbit at every quadrupole per ampere asked of every corrector, shape (q, m) [m/A]."""
        errors = self._layout.healthy
        gains = 1.0 if errors is None else 1.0 + errors.gains
        return self._orbit_at(plane) * gains

    def bend(self) -> Matrix:
        """What the errors change of the response beyond their own sum, shape (n, m) [m/A]."""
        bend = self.response - self._layout.response
        if (errors := self._layout.healthy) is not None:
            for plane, kick in errors.kicks.items():
                bend = bend - self.orbit_per_kick(plane) * kick @ self.orbit_at(plane)
        return bend

    def _orbit_at(self, plane: ChannelPlane) -> Matrix:
        straight = self._layout.orbit_at("QUAD", plane)
        return straight if self._layout.healthy is None else self._again(plane, straight)

    def _again(self, plane: ChannelPlane, orbit: Matrix) -> Matrix:
        """Let gradients kick an orbit at the quadrupoles, turn after turn, shape (q, k)."""
        errors = self._layout.healthy
        if errors is None:
            return orbit
        kick = errors.kicks[plane]
        between = green(self._layout.known_ring, "QUAD", "QUAD", plane)
        found: Matrix = np.linalg.inv(np.eye(len(kick)) - between * kick) @ orbit
        return found


def straightened(record: Record, errors: HealthyErrors, currents: Matrix) -> Record:
    """Take what healthy errors do beyond their own sum out of the readings.

    Args:
        record: Of a known ring.
        errors: That it is known to have.
        currents: That act on the beam, shape (N, m) [A].

    Returns:
        The record of a ring whose errors add up, around these.
    """
    layout = replace(record.layout, healthy=errors)
    moved = currents - currents.mean(axis=0)
    return replace(record, layout=layout, readings=record.readings - moved @ Bent(layout).bend().T)
