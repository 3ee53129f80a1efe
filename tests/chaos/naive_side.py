"""The plain loop as a process, with the operator who starts it again."""

from pathlib import Path

from tests.chaos.rings import Ring, Side, wait

GONE = 100e-6
"""True rms [m] after a fault from which somebody would start the plain loop anew."""


class Naive:
    """The plain loop on a ring.

    Args:
        directory: For what it prints.
        ring: Its ring.
        rate: Of the loop [Hz].
    """

    def __init__(self, directory: Path, ring: Ring, rate: float) -> None:
        directory.mkdir(parents=True)
        self.ring = ring
        self.side = Side(["-m", "tests.chaos.naive", str(rate)], directory, ring.port)
        self.died = self.again = 0
        wait(lambda: "running" in self.side.output() or not self.side.alive, 60.0)

    def look_after(self) -> None:
        """Start it anew if it has died or lost the orbit; count either."""
        died = not self.side.alive
        if died or self.ring.tell()["rms"] > GONE:
            self.died += died
            self.again += 1
            self.side.kill()
            self.ring.tell(restore=True)
            self.side.start()
