"""What an earlier measurement left behind: setpoints astray, columns that are done."""

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np

from orbitfb.config.tree import AppConfig
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import MeasurementError
from orbitfb.core.ports import Machine
from orbitfb.core.signals import Channels
from orbitfb.measure.column import Table
from orbitfb.measure.journal import Journal
from orbitfb.measure.measurement import conditions
from orbitfb.measure.mover import Mover, restore_persistently
from orbitfb.measure.watch import Watch
from orbitfb.physics.optics import Matrix
from orbitfb.safety.bounds import Bounds

Say = Callable[[str], None]


def put_back(
    machine: Machine,
    nominal: Matrix,
    journal: Journal,
    where: str,
    watch: Watch,
    config: AppConfig,
    restore: bool | None,
    say: Say,
    confirm: Callable[[str], bool] | None,
    bounds: Bounds | None = None,
) -> None:
    """Offer to put back what a killed measurement left astray.

    Setpoints that would move the orbit farther than a measurement may are not put back: somebody
    has set others since, or the record of them is wrong.
    """
    moved = journal.moved()
    if moved is None:
        return
    pvs = machine.channels.setpoint_pvs
    if moved.where != where or not set(moved.setpoint_pvs) <= set(pvs):
        raise MeasurementError(
            f"a measurement at {moved.where} was killed and may not have put setpoints back "
            f"({', '.join(moved.setpoint_pvs[:3])}); first start it there again, in the same "
            f"planes, or put them back by hand and remove {journal.directory / 'moved.json'}"
        )
    mine = np.array([pvs.index(name) for name in moved.setpoint_pvs])
    bounds = bounds or Bounds.of(config.limits.setpoint, len(pvs))
    mover = Mover(machine, config.limits, watch, config.measure.same_setpoint, bounds)
    away = np.abs(mover.base[mine] - moved.setpoints) > config.measure.same_setpoint
    if not away.any():
        journal.clear()
        return
    astray = "\n".join(
        f"  {pvs[mine[k]]}: {mover.base[mine[k]]:.6g} A, was {moved.setpoints[k]:.6g} A"
        for k in np.flatnonzero(away)[:10]
    )
    found = (
        f"a killed measurement of {datetime.fromtimestamp(moved.time, UTC):%Y-%m-%d %H:%M:%S} UTC "
        f"left {np.count_nonzero(away)} setpoints astray, the first ones:\n{astray}"
    )
    if restore is None and confirm is None:
        raise MeasurementError(
            f"{found}\ngive --restore to put them back, or --leave to leave them as they are now"
        )
    if confirm is not None and restore is None:
        restore = confirm(f"{found}\nPut them back?")
    if restore:
        low, high = bounds.low[mine], bounds.high[mine]
        beyond = (moved.setpoints < low) | (moved.setpoints > high)
        if beyond.any():
            first = int(beyond.argmax())
            raise MeasurementError(
                f"{found}\n{moved.setpoint_pvs[first]} was beyond limits.setpoint or its drive "
                f"limits ({low[first]:g} to {high[first]:g} A), so that nothing is moved; put the "
                "setpoints back by hand and give --leave"
            )
        step = moved.setpoints - mover.base[mine]
        far = float(np.sqrt(np.mean((nominal[:, mine] @ step) ** 2)))
        if not far <= config.measure.excursion_rms:
            raise MeasurementError(
                f"{found}\nto put them back would move the orbit by {far * 1e6:.4g} µm rms by the "
                "optics, farther than a measurement may (measure.excursion_rms, "
                f"{config.measure.excursion_rms * 1e6:g} µm), so that nothing is moved; put the "
                "setpoints back by hand and give --leave"
            )
        say(found)
        mover.base[mine] = moved.setpoints
        patience = config.measure.restore_timeout
        restore_persistently(mover, mine.tolist(), machine, SystemClock(), patience)
        say(f"{np.count_nonzero(away)} setpoints are back where the killed measurement found them")
    else:
        say(f"{np.count_nonzero(away)} setpoints stay as the killed measurement left them")
    journal.clear()


def taken_up(
    journal: Journal, channels: Channels, config: AppConfig, fresh: bool, now: float, say: Say
) -> Table:
    """Take up what a measurement that was stopped has done."""
    if fresh:
        journal.forget()
    kept = journal.load(conditions(config.measure), now - config.measure.resume_within)
    if kept is None or not kept.measured.any():
        return Table.empty(len(channels.bpms), len(channels.correctors))
    since = datetime.fromtimestamp(float(np.nanmin(kept.time)), UTC)
    say(
        f"going on with the measurement of {since:%Y-%m-%d %H:%M} UTC: "
        f"{np.count_nonzero(kept.measured)} correctors are done (--fresh starts again)"
    )
    return kept
