"""Closed bumps: position and angle at a place, as a change of the reference orbit."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from orbitfb.app.commands.arguments import number
from orbitfb.app.commands.autosave import SavedBump
from orbitfb.app.commands.vectors import MICRO
from orbitfb.core.errors import ControlError, RingError
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.bump import Bump, closed_bump, find_source
from orbitfb.physics.places import Plane, Planes, Ring, split


@dataclass(frozen=True, slots=True)
class Change:
    """What a request does to the reference.

    Args:
        bump: As it will be, whole and not added to what was.
        reference: What it leads to, shape (n,) [m]: exactly what was before the first bump, once
            the last one is gone.
        base: What was before the first bump, shape (n,) [m].
        setpoints: By how much the setpoints will about change, shape (m,) [A].
    """

    bump: SavedBump
    reference: Vector
    base: Vector
    setpoints: Vector

    def told(self, before: Vector) -> dict[str, Any]:
        """Tell it to who asked for it.

        Args:
            before: Reference before it, shape (n,) [m].
        """
        return {
            "place": self.bump.place,
            "plane": self.bump.plane,
            "position_um": self.bump.position / MICRO,
            "angle_urad": self.bump.angle / MICRO,
            "largest_reference_change_um": float(np.abs(self.reference - before).max() / MICRO),
            "largest_setpoint_change_A": float(np.abs(self.setpoints).max()),
        }


class Bumps:
    """Knows the bumps in force; each is what was asked for last at its place.

    Args:
        ring: The ring.
        channels: Of the loop.
        limits: Of what operators may set.
        movable: Gives the correctors that may move now, shape (m,).
        crossed: Says which correctors would go beyond their limits with a change of the setpoints,
            shape (m,) [A]; empty: none.

    Attributes:
        in_force: By place and plane.
        place: The one that was named last; empty: none.
    """

    def __init__(
        self,
        ring: Ring,
        channels: Channels,
        limits: PanelSettings,
        movable: Callable[[], Mask],
        crossed: Callable[[Vector], str] = lambda change: "",
    ) -> None:
        self._ring, self._channels, self._limits = ring, channels, limits
        self._movable, self._crossed = movable, crossed
        self.in_force: dict[tuple[str, str], SavedBump] = {}
        self._base: Vector = np.zeros(len(channels.bpms))
        self.place = ""

    def asked(self, request: Mapping[str, Any], reference: Vector) -> Change | None:
        """Work out what a request wants; None: it only names a place.

        Args:
            request: `place`, else that which was named last; `plane`; `position` [m] and `angle`
                [rad], each as it is now where it is left out.
            reference: That is wanted now, shape (n,) [m].

        Raises:
            ControlError: There is no such place, no such plane, or it is beyond the limits.
        """
        place = request.get("place", self.place)
        if not isinstance(place, str | int | float) or isinstance(place, bool) or place == "":
            raise ControlError("name the place of the bump first, place=NAME")
        place = str(place)
        try:
            source = find_source(self._ring, place)
        except RingError as error:
            raise ControlError(f"bump refused: {error}") from None
        if not {"plane", "position", "angle"} & request.keys():
            self.place = place
            return None
        plane = request.get("plane")
        planes = split(cast(Planes, self._channels.planes))
        if plane not in planes:
            raise ControlError(f"plane must be {' or '.join(planes)}, not {plane!r}")
        before = self.in_force.get((place, plane))
        limits = self._limits
        position = self._value(request, "position", before, limits.bump_limit)
        angle = self._value(request, "angle", before, limits.bump_angle_limit)
        try:
            made = closed_bump(self._ring, plane, source, position, angle, self._used(plane))
        except RingError as error:
            raise ControlError(f"bump refused: {error}") from None
        bump = self._saved(place, plane, position, angle, made)
        setpoints = np.array(bump.setpoints)
        if before is not None:
            setpoints = setpoints - before.setpoints
        if told := self._crossed(setpoints):
            raise ControlError(f"bump refused: {told} would go beyond their limits")
        base = self._base if self.in_force else reference
        after = self._with(bump)
        total = sum((np.array(other.orbit) for other in after.values()), base)
        return Change(bump, total, base, setpoints)

    def take(self, change: Change) -> None:
        """Remember a bump that is in force now."""
        self.place, self._base = change.bump.place, change.base
        self.in_force = self._with(change.bump)

    def forget(self) -> int:
        """Forget all: another reference was set; say how many there were."""
        count = len(self.in_force)
        self.in_force = {}
        return count

    def restore(self, saved: tuple[SavedBump, ...], reference: Vector) -> None:
        """Take up those that are part of a reference that was saved, shape (n,) [m]."""
        self.in_force = {(bump.place, bump.plane): bump for bump in saved}
        self._base = reference - sum((np.array(bump.orbit) for bump in saved), 0.0 * reference)

    def shown(self) -> dict[str, Any]:
        """Give the bump at the place named last, and all of them, by PV of the panel."""
        values: dict[str, Any] = {"BumpPlace-RB": self.place}
        for plane in self._channels.planes:
            bump = self.in_force.get((self.place, plane))
            values[f"BumpPosition{plane.upper()}-RB"] = bump.position / MICRO if bump else 0.0
            values[f"BumpAngle{plane.upper()}-RB"] = bump.angle / MICRO if bump else 0.0
        values["Bumps-I"] = "; ".join(map(_words, self.in_force.values()))
        return values

    def _value(
        self, request: Mapping[str, Any], key: str, before: SavedBump | None, limit: float
    ) -> float:
        if key in request:
            return number(request, key, -limit, limit)
        return float(getattr(before, key)) if before else 0.0

    def _used(self, plane: str) -> Mask:
        return self._movable()[self._channels.corrector_parts[plane]]

    def _with(self, bump: SavedBump) -> dict[tuple[str, str], SavedBump]:
        """Give all bumps with this one; one of position and angle 0 is none."""
        others = {key: its for key, its in self.in_force.items() if key != (bump.place, bump.plane)}
        if bump.position == 0.0 and bump.angle == 0.0:
            return others
        return {**others, (bump.place, bump.plane): bump}

    def _saved(
        self, place: str, plane: Plane, position: float, angle: float, made: Bump
    ) -> SavedBump:
        channels = self._channels
        orbit, setpoints = np.zeros(len(channels.bpms)), np.zeros(len(channels.correctors))
        orbit[channels.bpm_parts[plane]] = made.orbit
        setpoints[channels.corrector_parts[plane]] = made.kicks / self._ring.calibration(plane)
        return SavedBump(
            place=place,
            plane=plane,
            position=position,
            angle=angle,
            orbit=tuple(orbit.tolist()),
            setpoints=tuple(setpoints.tolist()),
        )


def _words(bump: SavedBump) -> str:
    position, angle = bump.position / MICRO, bump.angle / MICRO
    return f"{bump.place} {bump.plane} {position:g} um {angle:g} urad"
