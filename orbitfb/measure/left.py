"""What a measurement that was killed left behind, told to whoever uses the ring next."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from orbitfb.core.errors import MachineError, MeasurementError
from orbitfb.core.ports import Machine
from orbitfb.measure.journal import Journal

DIRECTORY = "measurement"
"""Where a measurement keeps its journal, below the data directory."""


def left_astray(data: Path, machine: Machine, where: str, ioc: str, same: float) -> str:
    """Say in a line that setpoints are still where a killed measurement left them.

    Args:
        data: Data directory.
        machine: The ring, which states its setpoints.
        where: The ring, as the journal calls it.
        ioc: The ring, as the command line calls it.
        same: Difference up to which a setpoint is where it was found [A].

    Returns:
        The line, with the command that puts them back; empty where there is nothing to say.
    """
    channels = machine.channels
    journal = Journal(data / DIRECTORY, channels, where)
    try:
        moved = journal.moved()
    except MeasurementError as error:
        return f"a measurement of the response was killed, and its journal tells nothing: {error}"
    if moved is None:
        return ""
    when = f"{datetime.fromtimestamp(moved.time, UTC):%Y-%m-%d %H:%M} UTC"
    at, count = moved.where, len(moved.setpoint_pvs)
    told = f"up to {count} setpoints at {at} away from where they were"
    if at == where and set(moved.setpoint_pvs) <= set(channels.setpoint_pvs):
        at = ioc
        try:
            present = machine.setpoints()
        except MachineError:
            present = np.full(len(channels.setpoint_pvs), np.nan)
        mine = [channels.setpoint_pvs.index(name) for name in moved.setpoint_pvs]
        away = ~(np.abs(present[mine] - moved.setpoints) <= same)
        if not away.any():
            return ""
        first = int(away.argmax())
        told = (
            f"{np.count_nonzero(away)} setpoints astray, such as {moved.setpoint_pvs[first]}: "
            f"{present[mine][first]:.6g} A, was {moved.setpoints[first]:.6g} A"
        )
    live = " --live" if moved.where.endswith(":5064") else ""
    command = f"orbitfb measure-response --ioc {at} --data {data} --restore{live}"
    return (
        f"a measurement of the response was killed on {when} and left {told}; to put them back "
        f"stop this loop, then `{command}`, which measures on afterwards until Ctrl-C"
    )
