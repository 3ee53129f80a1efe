"""The one family of errors.

    OrbitFeedbackError
    ├── ConfigError          a configuration key or value is wrong; names path and line
    ├── RingError            a places table, ring file or response matrix is wrong
    ├── MachineError         the machine, seen over its port
    │   ├── ConnectError     PVs that cannot be reached, all of them at once
    │   ├── NoOrbitError     no fresh and coherent orbit within the time allowed
    │   ├── AwayError        setpoints of which some cannot be asked; has the others
    │   └── WriteError       setpoints that were not, or not all, sent
    ├── OwnershipError       somebody else holds the port, the ring or the directory
    ├── ArchiveError         a segment of the archive cannot be read or written
    ├── StoreError           a policy or model file is missing, corrupt or not ours
    ├── MeasurementError     a response matrix that could not be measured
    │   └── StoppedError     somebody stopped it
    ├── RecordError          a record of operation has an array that is wrong
    ├── ExchangeError        a file from elsewhere that cannot be taken, or one that cannot be made
    ├── EstimationError      data from which no response can be identified
    ├── TrainingError        a training whose loss is no longer a number
    ├── CampaignError        tasks of a campaign failed; the results of the others are kept
    └── ControlError         a running service refused a command or cannot be asked

A message says what was wrong, where, and what to do. The command line prints it without a
traceback and exits with 2.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # a question to the service waits for no arithmetic
    import numpy as np
    from numpy.typing import NDArray


class OrbitFeedbackError(Exception):
    """Base of every error that orbitfb raises on purpose.

    One that a worker process raises arrives as it was, whatever it was made of.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.args, self.__dict__)


def _again(
    kind: type[OrbitFeedbackError], args: tuple[Any, ...], known: dict[str, Any]
) -> OrbitFeedbackError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(known)
    return error


class ConfigError(OrbitFeedbackError):
    """A configuration key or value is wrong."""


class RingError(OrbitFeedbackError):
    """A places table, a ring file or a response matrix is wrong."""


class MachineError(OrbitFeedbackError):
    """The machine did not do what its port promises."""


MOST_SHOWN = 10
"""Names that a message shows: with the lines around them half of a terminal of 24 lines, so that
its first line, which says how many there are, stays in sight."""


def few(names: Sequence[str]) -> str:
    """List names one a line; of many the first ones, and how many more there are.

    Args:
        names: In the order of the ring.
    """
    shown = [f"  {name}" for name in names[:MOST_SHOWN]]
    if len(names) > MOST_SHOWN:
        shown.append(f"  … and {len(names) - MOST_SHOWN} more")
    return "\n".join(shown)


class ConnectError(MachineError):
    """PVs that cannot be reached, counted all at once.

    Args:
        missing: Their names.
        total: How many there are.
        waited: For how long they were searched for [s].
        advice: What to look at.

    Attributes:
        missing: All of their names; the message shows the first ones.
        waited: As given.
    """

    def __init__(self, missing: Sequence[str], total: int, waited: float, advice: str) -> None:
        self.missing = tuple(missing)
        self.waited = waited
        super().__init__(
            f"{len(self.missing)} of {total} PVs did not connect within {waited:.1f} s:\n"
            f"{few(self.missing)}\n{advice}"
        )


class NoOrbitError(MachineError):
    """No fresh and coherent orbit arrived within the time allowed."""


class AwayError(MachineError):
    """Setpoints of which some cannot be asked, as they are away.

    Args:
        message: How many, and which.
        last: In force, or last known where away, shape (m,) [A].
        away: Which are away, shape (m,).
    """

    def __init__(
        self, message: str, last: "NDArray[np.float64]", away: "NDArray[np.bool_]"
    ) -> None:
        self.last, self.away = last, away
        super().__init__(message)


class WriteError(MachineError):
    """Setpoints that were not, or not all, sent."""


class OwnershipError(OrbitFeedbackError):
    """Somebody else holds the port, the ring or the directory."""


class ArchiveError(OrbitFeedbackError):
    """A segment of the archive cannot be read or written."""


class StoreError(OrbitFeedbackError):
    """A policy or model file is missing, corrupt or not ours."""


class EstimationError(OrbitFeedbackError):
    """Data from which no response can be identified."""


class TrainingError(OrbitFeedbackError):
    """A training whose loss is no longer a number."""


class CampaignError(OrbitFeedbackError):
    """Tasks of a campaign failed; the results of the others are kept.

    Args:
        failures: Of every task that failed: what it was, what went wrong, where (may be empty).
        results: Of all the tasks, in their order; None where one failed.
    """

    def __init__(
        self,
        failures: Sequence[tuple[str, str, str]],
        results: Sequence[dict[str, Any] | None] = (),
    ) -> None:
        self.failures = tuple(failures)
        self.results = tuple(results)
        told = "\n".join(f"  {task}: {error}\n{trace}" for task, error, trace in self.failures)
        super().__init__(
            f"{len(self.failures)} of {len(self.results)} tasks failed; the results of the others "
            f"are kept:\n{told}"
        )


class ControlError(OrbitFeedbackError):
    """A running service refused a command or cannot be asked."""


class RecordError(OrbitFeedbackError):
    """A record of operation that cannot be diagnosed: which array, which row, what is wrong."""


class ExchangeError(OrbitFeedbackError):
    """A file from elsewhere that cannot be taken, or one for elsewhere that cannot be made."""


class MeasurementError(OrbitFeedbackError):
    """A measurement of the response matrix was given up; the setpoints are back unless it says."""


class StoppedError(MeasurementError):
    """Somebody stopped a measurement."""
