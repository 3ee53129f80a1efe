"""The vectors that the panel shows: orbit, setpoints, changes and modes, plane by plane."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.app.commands.preview import Latest
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Channels, LoopState, Mask, TickRecord, Vector
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.safety.bounds import Bounds

MICRO, MILLI = 1e-6, 1e-3


@dataclass(frozen=True, slots=True)
class Sources:
    """Where the vectors come from; each is called from any thread.

    Args:
        channels: Of the loop.
        latest: The last orbit.
        slot: The policy in force.
        wanted: Gives what operators want.
        counting: BPMs that are not masked by configuration, shape (n,).
        movable: Gives the correctors that may move, shape (m,).
        bounds: Gives the limits of the setpoints that are in force.
    """

    channels: Channels
    latest: Latest
    slot: PolicySlot
    wanted: Callable[[], Adjustments]
    counting: Mask
    movable: Callable[[], Mask]
    bounds: Callable[[], Bounds]


class Vectors:
    """Gives the vectors by PV; remembers the modes of a policy as long as it is in force."""

    def __init__(self, sources: Sources) -> None:
        self._sources = sources
        self._of: Policy | None = None
        self._modes: dict[str, tuple[Vector, Vector | None]] = {}

    def shown(self) -> dict[str, Any]:
        """Give every vector that changes, by PV of the panel, in its units; None: not known."""
        sources = self._sources
        record = sources.latest.record
        movable = sources.movable()
        values = {**self._of_modes(), **self._by_corrector("CorrectorUsed", movable.astype(int))}
        if record is None or record.reading is None:
            return values
        return {**values, **self._of_orbit(record), **self._of_setpoints(record)}

    def _of_orbit(self, record: TickRecord) -> dict[str, Any]:
        if record.reading is None:
            return {}
        orbit, sources = record.reading.orbit, self._sources
        used = orbit.valid & np.isfinite(orbit.position)
        used &= sources.wanted().enabled & sources.counting
        position = np.where(used, orbit.position, np.nan)
        return {
            **self._by_bpm("Orbit", _rounded(position / MILLI, 6)),
            **self._by_bpm("Reference", _rounded(record.reference / MILLI, 6)),
            **self._by_bpm("Error", _rounded((position - record.reference) / MICRO, 3)),
            **self._by_bpm("BpmUsed", used.astype(int)),
        }

    def _of_setpoints(self, record: TickRecord) -> dict[str, Any]:
        now, bounds = record.setpoints + record.applied, self._sources.bounds()
        room = np.minimum(now - bounds.low, bounds.high - now)
        shadow = record.requested if record.state is LoopState.SHADOW else np.full_like(now, np.nan)
        return {
            **self._by_corrector("Setpoint", _rounded(now, 6)),
            **self._by_corrector("Computed", _rounded(record.requested, 7)),
            **self._by_corrector("Applied", _rounded(record.applied, 7)),
            **self._by_corrector("Shadow", _rounded(shadow, 7)),
            **self._by_corrector("Room", _rounded(room, 4)),
        }

    def _of_modes(self) -> dict[str, Any]:
        sources = self._sources
        policy, parts = sources.slot.acting, sources.channels.corrector_parts
        if policy is not self._of:
            self._modes = modes_of(policy, sources.channels)
            self._of = policy
        values: dict[str, Any] = {}
        gain = sources.wanted().gain
        for plane, part in parts.items():
            sigma, corrected = self._modes.get(plane, (None, None))
            factor = float(gain[part].mean())
            values[f"SingularValue{plane.upper()}-I"] = _listed(sigma, 9)
            values[f"ModeGain{plane.upper()}-I"] = _listed(
                None if corrected is None else factor * corrected, 6
            )
        return values

    def _by_bpm(self, name: str, values: NDArray[Any]) -> dict[str, Any]:
        return _cut(name, values, self._sources.channels.bpm_parts)

    def _by_corrector(self, name: str, values: NDArray[Any]) -> dict[str, Any]:
        return _cut(name, values, self._sources.channels.corrector_parts)


def modes_of(policy: Policy, channels: Channels) -> dict[str, tuple[Vector, Vector | None]]:
    """Give the singular values of a policy's response, and what it corrects of each mode.

    With R = U Σ Vᵀ of a plane and the law a = −K e at small errors, one tick takes the part
    uᵢᵀ R K uᵢ of mode i away.

    Args:
        policy: That acts.
        channels: Names behind its vectors.

    Returns:
        By plane: singular values, shape (min(n, m),) [m/A], and parts [1], None for a policy
        without a gain matrix; nothing for a policy without a response.
    """
    response: Vector | None = getattr(policy, "response", None)
    if response is None:
        return {}
    gain: Vector | None = getattr(policy, "gain_matrix", None)
    found: dict[str, tuple[Vector, Vector | None]] = {}
    columns = channels.corrector_parts
    for plane, rows in channels.bpm_parts.items():
        own = response[rows, columns[plane]]
        u, sigma, _ = np.linalg.svd(own, full_matrices=False)
        part = None
        if gain is not None:
            part = np.einsum("ni,ni->i", u, own @ (gain[columns[plane], rows] @ u))
        found[plane] = sigma, part
    return found


def still_vectors(ring: Ring, channels: Channels) -> dict[str, tuple[float, ...] | tuple[str, ...]]:
    """Give the vectors that never change, by PV: names and positions [m].

    Args:
        ring: Has the positions.
        channels: Of the loop.
    """
    where = dict(zip(ring.table.name, ring.table.s.tolist(), strict=True))
    values: dict[str, tuple[float, ...] | tuple[str, ...]] = {}
    for kind, names, parts in (
        ("Bpm", channels.bpms, channels.bpm_parts),
        ("Corrector", channels.correctors, channels.corrector_parts),
    ):
        for plane, part in parts.items():
            values[f"{kind}Name{plane.upper()}-I"] = names[part]
            values[f"{kind}Position{plane.upper()}-I"] = tuple(where[name] for name in names[part])
    return values


def _cut(name: str, values: NDArray[Any], parts: dict[str, slice]) -> dict[str, Any]:
    listed = [value if math.isfinite(value) else None for value in values.tolist()]
    return {f"{name}{plane.upper()}-I": listed[part] for plane, part in parts.items()}


def _listed(values: Vector | None, digits: int) -> list[float] | None:
    return None if values is None else _rounded(values, digits).tolist()


def _rounded(values: Vector, digits: int) -> Vector:
    """Leave out digits beyond what the PV shows: the text between the processes stays short."""
    return np.round(values, digits)
