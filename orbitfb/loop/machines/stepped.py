"""A machine whose setpoints hold steps only: whole numbers, or the digits of a converter."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.ports import Machine
from orbitfb.core.signals import Applied, Mask, Vector
from orbitfb.loop.machines.around import AroundMachine
from orbitfb.safety.verdict import name_some


class SteppedMachine(AroundMachine):
    """Any machine; what is written is rounded here, and what that leaves is kept for the next one.

    A record that rounds by itself takes changes below half a step for none, however many come: the
    loop would stand still and believe that it moves. Here the remainder is carried, so that small
    changes add up, and `write` says what was sent.

    Args:
        machine: The machine.
        step: Of each setpoint, shape (m,) [A]; 0: any value.
        limit: Largest |setpoint| of all [A].
        drive_limits: Gives those that the machine states, shape (m, 2), low and high [A]; NaN:
            none.
    """

    def __init__(
        self,
        machine: Machine,
        step: Vector,
        limit: float,
        drive_limits: Callable[[], NDArray[np.float64]],
    ) -> None:
        super().__init__(machine)
        self._step, self._limit = step, limit
        self._drive_limits = drive_limits
        self._carried = np.zeros(len(step))

    def write(self, setpoints: Vector, which: Mask | None = None) -> Applied:
        """Send the steps nearest to absolute setpoints; see `Machine`.

        Args:
            setpoints: Shape (m,) [A].
            which: Correctors to put, shape (m,); None: all.
        """
        coarse = self._step > 0
        put = coarse if which is None else coarse & which
        step = np.where(coarse, self._step, 1.0)
        bounds = self._drive_limits()
        low, high = np.fmax(bounds[:, 0], -self._limit), np.fmin(bounds[:, 1], self._limit)
        wanted = setpoints + self._carried
        sent = np.clip(np.round(wanted / step), np.ceil(low / step), np.floor(high / step)) * step
        sent = np.where(put, sent, setpoints)
        applied = super().write(sent, which)
        left = np.clip(wanted - sent, -0.499 * step, 0.499 * step)
        self._carried = np.where(put & np.isfinite(left), left, self._carried)
        return applied


def rounding_told(step: Vector, response: Vector, names: Sequence[str]) -> str:
    """Say what rounding of the setpoints does to the orbit; empty where nothing is rounded.

    A remainder is spread evenly over a step: its rms is the step over √12.

    Args:
        step: Of each setpoint, shape (m,) [A]; 0: any value.
        response: R, shape (n, m) [m/A].
        names: The m setpoints.
    """
    coarse = step > 0
    if not coarse.any():
        return ""
    moved: Vector = response * step
    rms = float(np.sqrt(np.sum(moved**2) / len(moved) / 12.0))
    return (
        f"{np.count_nonzero(coarse)} of {len(step)} setpoints hold steps only, of up to "
        f"{step.max():g} A: {name_some(coarse, names)}; rounding alone moves the orbit by about "
        f"{rms * 1e6:.3g} µm rms"
    )


def stepped(
    machine: Machine,
    step: Vector,
    limit: float,
    drive_limits: Callable[[], NDArray[np.float64]],
) -> Machine:
    """Round for a machine whose setpoints hold steps; any other one is given back as it is.

    Args:
        machine: The machine.
        step: Of each setpoint, shape (m,) [A].
        limit: Largest |setpoint| of all [A].
        drive_limits: See `SteppedMachine`.
    """
    return SteppedMachine(machine, step, limit, drive_limits) if step.any() else machine
