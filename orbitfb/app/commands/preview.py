"""Another cut, another λ, other weights of the BPMs: what it would do, before it does it."""

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from orbitfb.app.commands.arguments import plane_of
from orbitfb.core.errors import ControlError, OrbitFeedbackError
from orbitfb.core.signals import Channels, Mask, TickRecord, Vector
from orbitfb.learn.builders import masked, unmasked
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.blocks import Plane, sized
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import LARGEST_WEIGHT, PlaneLaw, SvdPolicy, SvdSettings

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]
LARGEST_LAMBDA = 1.0
"""Largest λ that is accepted [m/A]."""


class Latest:
    """Keeps the last record of the loop that has an orbit."""

    def __init__(self) -> None:
        self.record: TickRecord | None = None

    def __call__(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        if record.reading is not None:
            self.record = record

    @property
    def error(self) -> tuple[Vector, Mask]:
        """The last orbit error, shape (n,) [m], 0 where not valid, and what of it is valid.

        Raises:
            ControlError: No orbit has come yet.
        """
        record = self.record
        if record is None or record.reading is None:
            raise ControlError("no orbit has come yet, so that nothing can be predicted")
        orbit = record.reading.orbit
        valid = orbit.valid & np.isfinite(orbit.position)
        return np.where(valid, orbit.position - record.reference, 0.0), valid


class Trial:
    """Tries an SVD law on the response of the policy in force.

    Args:
        slot: The policy in force.
        store: Where one that is applied is stored.
        channels: Of the loop.
        configured: Settings of the SVD law for a policy in force that is none.
        latest: The last orbit.
        movable: Gives the correctors that may move now, shape (m,).
        activate: Puts a stored policy in force, with all its checks: the command `activate`.
    """

    def __init__(
        self,
        slot: PolicySlot,
        store: PolicyStore,
        channels: Channels,
        configured: SvdSettings,
        latest: Latest,
        movable: Callable[[], Mask],
        activate: Handler,
    ) -> None:
        self._slot, self._store, self._channels = slot, store, channels
        self._configured, self._latest = configured, latest
        self._movable, self._activate = movable, activate
        self._lock = threading.Lock()
        self._wanted: tuple[Mapping[str, Any], ...] = ()
        self._policy: SvdPolicy | None = None
        self._incumbent = ""
        self._predicted: dict[str, float] = {}

    @property
    def handlers(self) -> dict[str, Handler]:
        """The commands by name."""
        return {"try": self._try, "apply": self._apply}

    def shown(self) -> dict[str, Any]:
        """Give what is in force and what the last trial predicts, by PV of the panel."""
        inside = unmasked(self._slot.current)
        settings = inside.settings if isinstance(inside, SvdPolicy) else None
        bpms = len(self._channels.bpms)
        weights = None if settings is None else list(settings.bpm_weights or (1.0,) * bpms)
        return {
            "BpmWeight-RB": weights,
            **_cuts(settings, self._channels),
            "PredictedMax-I": self._predicted.get("largest_change_A"),
            "PredictedRms-I": self._predicted.get("rms_change_A"),
            "PredictedOrbit-I": self._predicted.get("orbit_rms_um"),
        }

    def _try(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Build the law with what was asked for so far and predict its next change."""
        with self._lock:
            current = self._slot.current
            inside: Any = unmasked(current)
            settings = inside.settings if isinstance(inside, SvdPolicy) else self._configured
            wanted = _added(self._wanted, request)
            for each in wanted:
                settings = self._with(settings, each)
            policy = SvdPolicy(
                inside.response, settings, covariance=getattr(inside, "covariance", None)
            )
            predicted = self._predict(policy)
            self._wanted, self._policy, self._predicted = wanted, policy, predicted
            self._incumbent = current.policy_id
            return {"policy": policy.policy_id, **predicted}

    def _apply(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        with self._lock:
            policy = self._policy
            if policy is None:
                raise ControlError("nothing was tried yet: set the cut or lambda first")
            parent = self._slot.current.policy_id
            if parent != self._incumbent:
                raise ControlError(
                    "the policy in force has changed since the trial; try again, then apply"
                )
            self._store.save(policy, self._channels, parent=parent)
            answer = self._activate(
                {**request, "command": "activate", "policy": policy.policy_id, "force": False}
            )
            self._wanted, self._policy, self._predicted = (), None, {}
            return answer

    def _with(self, settings: SvdSettings, request: Mapping[str, Any]) -> SvdSettings:
        """Give the settings with what was asked for; a cut or λ without a plane is of the whole."""
        plane: Plane | None = None
        if "plane" in request:
            plane = "x" if plane_of(request, self._channels.planes) == "x" else "y"
        cut = self._cut(request, plane)
        if not cut and "weights" not in request:
            raise ControlError("try takes singular_values, regularisation, weights, or several")
        changes: dict[str, Any] = {}
        if "weights" in request:
            changes["bpm_weights"] = self._weights(request["weights"])
        if plane is None:
            changes |= cut | ({"planes": {}} if cut else {})
        elif cut:
            laws = sized(settings.planes, self._channels)
            laws[plane] = laws[plane].model_copy(update=cut)
            changes["planes"] = laws
        else:
            raise ControlError("plane goes with singular_values or regularisation")
        return settings.model_copy(update=changes)

    def _cut(self, request: Mapping[str, Any], plane: str | None) -> dict[str, Any]:
        """Read a cut and a λ."""
        checked: dict[str, Any] = {}
        modes = modes_in(self._channels, plane)
        if "singular_values" in request:
            value = request["singular_values"]
            if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= modes:
                raise ControlError(f"singular_values must be from 1 to {modes}, not {value!r}")
            checked["singular_values"] = value
        if "regularisation" in request:
            value = request["regularisation"]
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not 0.0 <= value <= LARGEST_LAMBDA:
                raise ControlError(
                    f"regularisation must be from 0 to {LARGEST_LAMBDA:g} m/A, not {value!r}"
                )
            checked["regularisation"] = float(value)
        return checked

    def _weights(self, values: object) -> tuple[float, ...]:
        size = len(self._channels.bpms)
        good = isinstance(values, list) and all(
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and 0.0 <= value <= LARGEST_WEIGHT
            for value in values
        )
        if not isinstance(values, list) or not good or len(values) != size or not any(values):
            raise ControlError(
                f"weights must be {size} numbers from 0 to {LARGEST_WEIGHT:g}, one per BPM and "
                "plane, at least one above 0"
            )
        return tuple(map(float, values))

    def _predict(self, policy: SvdPolicy) -> dict[str, float]:
        """Say what the law would do at the next tick, and what orbit it expects then."""
        error, valid = self._latest.error
        acting = masked(policy, self._movable())
        change, _ = acting.act(error, valid, acting.initial_state())
        after = (error + policy.response @ change)[valid]
        if not np.isfinite(change).all():
            raise OrbitFeedbackError("that law asks for changes that are not finite")
        return {
            "rms_change_A": float(np.sqrt(np.mean(change**2))),
            "largest_change_A": float(np.abs(change).max()),
            "orbit_rms_um": float(np.sqrt(np.mean(after**2)) * 1e6),
        }


def modes_in(channels: Channels, plane: str | None = None) -> int:
    """Count the modes of a plane, or of the whole response.

    Args:
        channels: Of the loop.
        plane: The plane; None: all of them.
    """
    rows, columns = len(channels.bpms), len(channels.correctors)
    if plane is not None:
        row, column = channels.bpm_parts[plane], channels.corrector_parts[plane]
        rows, columns = row.stop - row.start, column.stop - column.start
    return min(rows, columns)


def _added(
    before: tuple[Mapping[str, Any], ...], request: Mapping[str, Any]
) -> tuple[Mapping[str, Any], ...]:
    """Add a request to those that are tried, in the place of an older one for the same things."""

    def about(its: Mapping[str, Any]) -> tuple[frozenset[str], object]:
        return frozenset(its) - {"origin", "peer"}, its.get("plane")

    return (*(old for old in before if about(old) != about(request)), request)


def _cuts(settings: SvdSettings | None, channels: Channels) -> dict[str, Any]:
    """Give cut and λ in force by PV; None: that plane or the whole has none of its own."""
    values: dict[str, Any] = {"Modes-RB": None, "Lambda-RB": None}
    several = len(channels.planes) > 1
    if settings is not None and not settings.planes:
        values["Modes-RB"] = settings.singular_values or modes_in(channels)
        values["Lambda-RB"] = settings.regularisation
    laws: dict[str, PlaneLaw] = {} if settings is None else {**settings.planes}
    for plane in channels.planes if several else ():
        law = laws.get(plane)
        modes = law and (law.singular_values or modes_in(channels, plane))
        values[f"Modes{plane.upper()}-RB"] = modes
        values[f"Lambda{plane.upper()}-RB"] = (
            law
            and settings
            and (settings.regularisation if law.regularisation is None else law.regularisation)
        )
    return values
