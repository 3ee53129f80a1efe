"""Whether the rules held, from what the soft IOC wrote down and from what was seen."""

from collections import Counter
from datetime import datetime
from typing import Any

import numpy as np

from tests.chaos.schedule import Lived

EXCESS = 1
"""Puts to one setpoint beyond the orbits to act on, of the last five: one may be under way when
such an orbit is followed by one that may not be acted on."""
LATE_TICKS = 10
"""Age of that orbit in orbits; 10 are the second after which a loop at 10 Hz calls it stale."""
DUMP = 3e-3
"""|orbit| at which a machine dumps its beam [m]."""
FAR = 1e-3
"""Rms [m] that the loop itself calls a distortion."""
WELL = 20e-6
"""Rms [m] that users would not notice."""


def not_to_act_on(rows: np.ndarray) -> np.ndarray:
    """Whether a write in each record came on an orbit that may not be acted on."""
    late = rows["tick"] - rows["good"] > LATE_TICKS
    return (rows["puts"] > 0) & ((rows["excess"] > EXCESS) | late)


def put_figures(rows: np.ndarray, rate: float) -> dict[str, Any]:
    """Count what was put, and what the beam did.

    Args:
        rows: Records of a journal.
        rate: Of the orbits [Hz].
    """
    puts = rows[rows["puts"] > 0]
    age = puts["tick"] - puts["good"]
    edges = np.diff((rows["peak"] > DUMP).astype(int), prepend=0)
    return {
        "ticks": len(rows),
        "ring hours at 10 Hz": round(len(rows) / 36000, 3),
        "orbits written on": len(puts),
        "setpoints put": int(puts["puts"].sum()),
        "puts not finite": int(puts["nonfinite"].sum()),
        "puts over the limit": int(puts["beyond"].sum()),
        "puts over the drive limit": int(puts["refused"].sum()),
        "steps over the limit": int(puts["steps"].sum()),
        "writes on an orbit not to act on": int(not_to_act_on(rows).sum()),
        "largest setpoint put [A]": round(float(puts["largest"].max(initial=0)), 4),
        "longest step [A]": round(float(puts["step"].max(initial=0)), 4),
        "oldest orbit written on [ticks]": int(age.max(initial=0)),
        "beam beyond 3 mm [times]": int((edges == 1).sum()),
        "worst rms [um]": round(float(rows["rms"].max(initial=0)) * 1e6, 1),
        "time beyond 1 mm rms [s]": round(float((rows["rms"] > FAR).sum()) / rate, 1),
        "time beyond 20 um rms [s]": round(float((rows["rms"] > WELL).sum()) / rate, 1),
    }


WANDERS = 40e-6
"""|orbit| [m] by which one may grow because of devices that look well and do not answer: twice
what a BPM may owe before the loop waits (`answer_reach`, `MOST`), as its neighbours owe too."""


BEFORE = 3
"""Orbits of such a fault that may still be of what was before: a kick that ends as it begins shows
in the orbit after, or in the one after that."""


def wandered(rows: np.ndarray, lived: list[Lived]) -> list[str]:
    """Say where the beam was moved far by devices that do not answer.

    Args:
        rows: Records of a journal.
        lived: The episodes as they were; those with other faults are left out.
    """
    found = []
    following = [one.begin for one in lived[1:]] + [float("inf")]
    for each, after in zip(lived, following, strict=True):
        if not each.episode.is_unanswered:
            continue
        end = min(each.end + 0.2, after)
        peaks = rows["peak"][(rows["wall"] >= each.begin) & (rows["wall"] <= end)]
        rise = float(peaks.max() - peaks[:BEFORE].max()) if len(peaks) else 0.0
        if rise > WANDERS:
            found.append(
                f"episode {each.episode.number}: |orbit| grew by {rise * 1e6:.0f} um while devices "
                f"did not answer"
            )
    return found


OVERLAP = 1.0
"""Time by which the post-mortem of a trip may come after the next trip [s]."""

MUST_BE_ZERO = (
    "puts not finite",
    "puts over the limit",
    "puts over the drive limit",
    "steps over the limit",
    "writes on an orbit not to act on",
)


def broken_rules(figures: dict[str, Any]) -> list[str]:
    """Name the rules about puts that were broken."""
    return [f"{name}: {figures[name]}" for name in MUST_BE_ZERO if figures[name]]


def broken_in(rows: np.ndarray, lived: list[Lived]) -> dict[int, int]:
    """Count the records that broke a rule about puts, by the number of their episode.

    Args:
        rows: Records of a journal.
        lived: The episodes as they were.
    """
    names = ("nonfinite", "beyond", "refused", "steps")
    broken = not_to_act_on(rows) | np.any([rows[name] > 0 for name in names], axis=0)
    begins = [each.begin for each in lived]
    at = np.searchsorted(begins, rows["wall"][broken], "right") - 1
    return dict(sorted(Counter(lived[max(index, 0)].episode.number for index in at).items()))


def trips(
    log: list[dict[str, Any]],
    postmortems: list[dict[str, Any]],
    unlogged: list[tuple[float, float]],
) -> list[str]:
    """Say which trips are not explained.

    Args:
        log: State changes.
        postmortems: Lines about post-mortems that were written.
        unlogged: When the log could not say so: the disk was full, or the process was killed.
    """
    tripped = [line for line in log if line.get("state") == "TRIPPED"]
    written = sorted(_moment(line) for line in postmortems)
    problems = []
    for number, line in enumerate(tripped):
        if not line["reason"]:
            problems.append(f"no reason for the trip at {line['timestamp']}")
        moment = _moment(line)
        following = _moment(tripped[number + 1]) if number + 1 < len(tripped) else float("inf")
        known = any(moment <= at <= following + OVERLAP for at in written)
        if not known and not any(begin <= moment <= end for begin, end in unlogged):
            problems.append(f"no post-mortem of the trip at {line['timestamp']}")
    return problems


def _moment(line: dict[str, Any]) -> float:
    return datetime.fromisoformat(line["timestamp"]).timestamp()


def reasons(log: list[dict[str, Any]]) -> dict[str, int]:
    """Count the trips by the beginning of their reason."""
    words = Counter(
        " ".join(w for w in line["reason"].split()[:8] if not any(c.isdigit() for c in w))
        for line in log
        if line.get("state") == "TRIPPED"
    )
    return dict(words.most_common())
