"""What the next orbit should be, and what the loop has asked for without a sign of an answer.

An observer follows the orbit, knowing what was sent: p = R a is added, and some of the surprise
that is left, or all of it after a kick. What was asked for since a device last answered is what
its reading, or its field, may be wrong by if it does not: the loop lets it not become large without
asking (`answering`).

A step that is much larger than the noise needs no question: it shows by itself.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.robust import median
from orbitfb.core.signals import FINEST, Mask, Vector
from orbitfb.core.values import replace
from orbitfb.safety.answers.questions import CLIP, MEDIAN, Ring

FOLLOWING = 0.4
"""Share of a surprise that the observer takes over [1]: noise of 1.12 times its least size is left,
and a move that was not made is forgotten in four orbits."""

STILL = 0.2
"""The same of the average of the readings [1]: 1.05 times."""

MEMORY = 50.0
"""Orbits over which the usual size of a surprise is averaged: long beside a kick, short beside a
shift."""

KICKED = 2.0
"""Mean square of a surprise over the usual one that a kick counts as [1]: noise that has really
grown is known by a factor of two in 35 orbits, kicks of one orbit in five change it by little."""

CALM = 0.5
"""Size of the surprises of one orbit, over the usual one, from which that was too large [1]."""

PLAIN = 10.0
"""Times its noise from which the step of a single BPM shows by itself [1]."""

NEAR = 0.5
"""Largest part of a predicted step that may be missing or too much if it was made [1]."""


@dataclass(frozen=True, eq=False)
class Expectation:
    """What is expected of the next orbit.

    Args:
        model: Orbit of the observer, shape (n,) [m].
        still: Average of the last readings, shape (n,) [m].
        power: Mean square of the surprise, shape (n,) [m²].
        recent: What of the last changes is in the surprise if a corrector took none, (m,) [A].
        left: What of them is in the next one too, shape (m,) [A].
        before: The last reading, shape (n,) [m].
        orbits: Orbits that were seen.
    """

    model: Vector
    still: Vector
    power: Vector
    recent: Vector
    left: Vector
    before: Vector
    orbits: int

    @classmethod
    def first(cls, position: Vector, correctors: int) -> "Expectation":
        """Begin with an orbit, shape (n,) [m]; finite."""
        power = np.full(position.shape, FINEST**2)
        nothing = np.zeros(correctors)
        return cls(position, position, power, nothing, nothing, position, 1)

    @property
    def spread(self) -> Vector:
        """Usual size of a surprise, shape (n,) [m]."""
        return np.sqrt(self.power)

    def surprise(self, position: Vector, moved: Vector) -> Vector:
        """Give what of an orbit was not expected, shape (n,) [m].

        Args:
            position: Shape (n,) [m].
            moved: What the changes of the setpoints should have moved it, shape (n,) [m].
        """
        return position - self.model - moved

    def follow(self, position: Vector, moved: Vector, change: Vector, seen: Mask) -> "Expectation":
        """Take over an orbit.

        Args:
            position: Shape (n,) [m].
            moved: What the changes should have moved it, shape (n,) [m].
            change: Those changes, shape (m,) [A].
            seen: BPMs that count, shape (n,).
        """
        surprise = self.surprise(position, moved)
        square, orbits = surprise**2, self.orbits + 1
        fresh = seen & (position != self.before)  # a reading that is repeated says nothing of noise
        kicked = _quiet(square[fresh], self.power[fresh]) > CLIP**2
        following, still = (1.0, 1.0) if kicked else (FOLLOWING, STILL)
        settled = orbits > 2 * CLIP  # before, the first orbits are not known to be usual
        if settled:  # a kick is no noise; if it were, that would be known after a while
            square = np.minimum(square, (KICKED if kicked else CLIP**2) * self.power)
        power = self.power + max(1.0 / MEMORY, 1.0 / orbits) * (square - self.power)
        quiet = _quiet(square[fresh], power[fresh])
        if quiet < CALM**2:  # after a kick, or the closing, the whole ring is calm again
            power = power * np.sqrt(quiet)
        return replace(
            self,
            model=self.model + moved + np.where(seen, following * surprise, 0.0),
            still=self.still + np.where(seen, still * (position - self.still), 0.0),
            power=np.where(fresh, np.maximum(power, FINEST**2), self.power),
            recent=self.left + change,
            left=(1.0 - following) * (self.left + change),
            before=position,
            orbits=orbits,
        )

    def unseen(self, moved: Vector, change: Vector) -> "Expectation":
        """Live through an orbit that nobody saw.

        Args:
            moved: What the changes should have moved it, shape (n,) [m].
            change: Those changes, shape (m,) [A].
        """
        return replace(self, model=self.model + moved, left=self.left + change)


def _quiet(square: Vector, power: Vector) -> float:
    """Give the mean square of all over what it was thought to be, by its median."""
    return median(square / power) / MEDIAN if square.size else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Owed:
    """What was asked for since the last sign of an answer.

    Args:
        ring: Predicted for the orbit since the ring answered, shape (n,) [m].
        bpms: The same since each BPM did, shape (n,) [m].
        correctors: Changes since each corrector did, shape (m,) [A].
    """

    ring: Vector
    bpms: Vector
    correctors: Vector

    @classmethod
    def nothing(cls, n: int, m: int) -> "Owed":
        """Begin: nothing was asked for."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(m))

    def add(self, moved: Vector, change: Vector) -> "Owed":
        """Ask for more: `moved` of the orbit, shape (n,) [m], by a change, shape (m,) [A]."""
        return Owed(self.ring + moved, self.bpms + moved, self.correctors + change)

    def paid(self, ring: bool, devices: Mask) -> "Owed":
        """Strike out what answered.

        Args:
            ring: Whether the ring as a whole did.
            devices: Shape (n + m,).
        """
        if not ring and not devices.any():
            return self
        n = len(self.bpms)
        return Owed(
            np.zeros(n) if ring else self.ring,
            np.where(devices[:n], 0.0, self.bpms),
            np.where(devices[n:], 0.0, self.correctors),
        )

    def sizes(self, ring: Ring) -> Vector:
        """Say how much it is: of each BPM and corrector, shape (n + m,) [m]."""
        return np.concatenate((np.abs(self.bpms), np.abs(self.correctors) * ring.sizes))


def shown(
    step: Vector, moved: Vector, change: Vector, seen: Mask, noise: Vector, least: float, ring: Ring
) -> tuple[bool, Mask]:
    """Find who plainly answered a large change in one step of the orbit.

    Args:
        step: Of the orbit, shape (n,) [m].
        moved: What it should be, shape (n,) [m].
        change: Of the setpoints, shape (m,) [A].
        seen: BPMs that count in both orbits, shape (n,).
        noise: Of each BPM as it was of late, shape (n,) [m].
        least: Rms of a step that is large [m].
        ring: The response.

    Returns:
        Whether the ring as a whole did, and which BPMs and correctors, shape (n + m,).
    """
    count = int(np.count_nonzero(seen))
    asked = np.where(seen, moved, 0.0)
    power = float(asked @ asked)
    nobody = np.zeros(len(moved) + len(change), dtype=np.bool_)
    missing = np.where(seen, step - moved, 0.0)
    if count == 0 or float(missing @ missing) > NEAR**2 * power:
        return False, nobody
    # What the whole orbit misses bounds its noise: what was usual may still be that of a kick.
    usual = max(median(noise[seen]), FINEST)
    noise = noise * min(1.0, median(np.abs(missing[seen])) / (np.sqrt(MEDIAN) * usual))
    floor = max(least, PLAIN * median(noise))
    if power < count * floor**2:
        return False, nobody
    large = np.maximum(least, PLAIN * noise)
    bpms = seen & (np.abs(moved) >= large) & (np.abs(missing) <= NEAR * np.abs(moved))
    size = np.maximum(len(step) * ring.sizes**2, np.finfo(np.float64).tiny)
    part = np.abs(missing @ ring.response) / size
    correctors = (np.abs(change) * ring.sizes >= floor) & (part <= NEAR * np.abs(change))
    return True, np.concatenate((bpms, correctors))
