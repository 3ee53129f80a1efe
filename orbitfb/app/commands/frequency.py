"""The command by which operators let the RF frequency follow, or leave it alone."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from orbitfb.app.commands.vectors import MICRO
from orbitfb.core.errors import ControlError
from orbitfb.loop.frequency import Follower, Sight

OFF, FOLLOWS, STOPPED = "OFF", "FOLLOWS", "STOPPED"
"""Words of the panel: nobody wants it, or by command; it follows while the loop is closed; the loop
has let go of it."""


@dataclass(frozen=True, slots=True)
class FrequencyCommands:
    """Answers the command `rf`.

    Args:
        follower: Steps the frequency; None: it is left alone.
    """

    follower: Follower | None

    @property
    def handlers(self) -> dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]:
        """The commands by name."""
        return {"rf": self._follow}

    @property
    def sight(self) -> Sight:
        """How the frequency is."""
        return Sight() if self.follower is None else self.follower.sight

    def shown(self) -> dict[str, Any]:
        """Give how the frequency is, by PV of the panel, in its units."""
        sight = self.sight
        wanted = self.follower is not None and self.follower.wanted
        known = sight.frequency == sight.frequency
        return {
            "RfState-I": FOLLOWS if sight.following else STOPPED if wanted else OFF,
            "RfReason-I": sight.reason,
            "RfFrequency-I": sight.frequency if known else None,
            "RfEnergy-I": _known(sight.energy / MICRO),
            "RfStep-I": _known(sight.last_step),
            "RfSteps-I": sight.steps,
            "RfColumn-I": _known(sight.ratio),
        }

    def _follow(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        follow = request.get("follow")
        if not isinstance(follow, bool):
            raise ControlError(f"follow must be true or false, not {follow!r}")
        if self.follower is None:
            raise ControlError(
                "the loop leaves the RF frequency alone; set rf.enabled = true and start it again"
            )
        if follow and self.follower.sight.reason:
            self.follower.again()
        self.follower.wanted = follow
        return {"follow": follow}


def _known(value: float) -> float | None:
    return value if value == value else None
