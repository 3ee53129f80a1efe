"""The gap between model and machine as the service sees it: shared by watch, metrics and log."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GapSight:
    """One look at the last ticks.

    Args:
        time: Stamp of the last tick looked at [s since the epoch].
        ticks: How many were looked at.
        nats: Gap of the nominal model to the best explanation [nats/tick]; 0 when there is none.
        low: Lower end of its 90 % interval [nats/tick].
        high: Upper end [nats/tick].
        resolved: Whether it is certain that there is one.
        effect: Id of the suspected effect; empty when there is none.
        places: Names of its devices.
        planes: Their planes.
        probability: Of the suspected effect, or one that breaks the same devices as well, among
            all and none [1].
        since: When it began [s since the epoch]; the first tick looked at, if before that.
        duration: How long the look took [s].
    """

    time: float
    ticks: int
    nats: float
    low: float
    high: float
    resolved: bool
    effect: str = ""
    places: tuple[str, ...] = ()
    planes: tuple[str, ...] = ()
    probability: float = 0.0
    since: float = float("nan")
    duration: float = 0.0
