"""What a run came to, as one JSON object."""

import errno
import os
import tempfile
from pathlib import Path
from typing import Any

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.files.state import AS_USUAL, replace_file
from orbitfb.core.refit import Decision
from orbitfb.observe.plain import dumps, plain
from orbitfb.observe.statistics.running import LATENCY_WINDOW
from orbitfb.observe.statistics.snapshot import LoopSnapshot

SCHEMA = 1
"""Version of the layout; a key that changes its meaning raises it."""


def summary(snapshot: LoopSnapshot) -> dict[str, Any]:
    """Return the figures of a run; what is unknown is None.

    Args:
        snapshot: The last snapshot of the run.

    Returns:
        Names carry their units: `_um`, `_ms`, `_s`, `_A`. `last_10s` is the quadratic mean over
        the last 10 s of orbit stamps; the percentiles of the latency are over its last
        `window_s`.
    """
    orbit, ticks, latency = snapshot.orbit, snapshot.ticks, snapshot.latency
    refits = snapshot.refits
    figures = {
        "schema": SCHEMA,
        "state": snapshot.state,
        "reason": snapshot.reason,
        "duration_s": snapshot.duration,
        "orbit_rms_um": {
            "first": orbit.first * 1e6,
            "last_10s": orbit.observed.window * 1e6,
            "true_last_10s": orbit.true.window * 1e6,
        },
        "ticks": ticks.ticks,
        "missed_ticks": ticks.missed,
        "limited_ticks": snapshot.correctors.limited,
        "latency_ms": {
            "p50": latency.p50 * 1e3,
            "p99": latency.p99 * 1e3,
            "max": latency.largest * 1e3,
            "window_s": LATENCY_WINDOW,
        },
        "period_ms": ticks.period * 1e3,
        "jitter_ms": ticks.jitter * 1e3,
        "bpms": orbit.bpms,
        "bpms_masked": orbit.masked,
        "bpms_invalid": orbit.invalid,
        "corrector_nearest_limit": {
            "name": snapshot.correctors.name or None,
            "setpoint_A": snapshot.correctors.setpoint,
            "limit_A": snapshot.correctors.limit,
        },
        "policy": snapshot.policy_id or None,
        "swaps": snapshot.swaps,
        "refits": snapshot.judged,
        "promotions": refits[Decision.PROMOTED],
        "refusals": refits[Decision.REFUSED],
        "roll_backs": refits[Decision.ROLLED_BACK],
        "alarms": snapshot.alarms,
        "last_refit": None
        if snapshot.last_refit is None
        else {
            "number": snapshot.last_refit.number,
            "decision": snapshot.last_refit.decision,
            "reason": snapshot.last_refit.reason,
            "policy": snapshot.last_refit.policy_id,
            "figures": snapshot.last_refit.figures,
        },
        "state_entries": snapshot.entries,
    }
    return plain(figures)


def check_place(path: Path) -> None:
    """See that a summary can be written, before the run that it is about.

    Args:
        path: Where to; nothing is left there.

    Raises:
        OrbitFeedbackError: The file could not be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> OrbitFeedbackError:
    above_is_a_file = isinstance(error, FileExistsError)  # where a directory was to be made
    problem = os.strerror(errno.ENOTDIR) if above_is_a_file else error.strerror
    return OrbitFeedbackError(
        f"the summary cannot be written to {path}: {problem}; "
        "name a file in a directory that can be written to"
    )


def write_summary(path: Path, snapshot: LoopSnapshot) -> None:
    """Write the summary of a run: the whole file or none.

    Args:
        path: Where to; a file that is there is replaced.
        snapshot: The last snapshot of the run.

    Raises:
        OrbitFeedbackError: The file cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = dumps(summary(snapshot), indent=2) + "\n"
        replace_file(path, text.encode(), AS_USUAL, part)
    except OSError as error:
        raise _unwritable(path, error) from error
