"""How far a measurement of the response is, for people and programs."""

from dataclasses import dataclass
from enum import StrEnum


class Stage(StrEnum):
    """What a measurement is at."""

    IDLE = "IDLE"
    MEASURING = "MEASURING"
    PUTTING_BACK = "PUTTING BACK"
    DONE = "DONE"
    ABORTED = "ABORTED"
    FAILED = "FAILED"


RUNNING = (Stage.MEASURING, Stage.PUTTING_BACK)
"""Stages in which setpoints may be away from where they were found."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far it is.

    Args:
        stage: What it is at.
        done: Correctors that are done.
        total: Correctors to measure.
        share: Part of the orbits that were taken, 0 to 1.
        left: Time that is left [s]; 0 when nothing runs.
        text: What came of the last one, or what is going on.
    """

    stage: Stage = Stage.IDLE
    done: int = 0
    total: int = 0
    share: float = 0.0
    left: float = 0.0
    text: str = ""

    @property
    def running(self) -> bool:
        """Whether setpoints may be away from where they were found."""
        return self.stage in RUNNING


def progress_of(seen: int, planned: int, elapsed: float, period: float) -> tuple[float, float]:
    """Say how far a measurement is by its orbits: the share that was taken, and the time left [s].

    Args:
        seen: Orbits that were taken.
        planned: Orbits that it needs.
        elapsed: Since the first of them [s].
        period: Time between two orbits to believe as long as nothing was seen [s].
    """
    if planned <= 0:
        return 0.0, 0.0
    each = elapsed / seen if seen > 0 else period
    return min(1.0, seen / planned), each * max(0, planned - seen)
