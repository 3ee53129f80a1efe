"""The commands that adjust a running loop: gain, reference, enable lists, dither.

Each is checked as a whole, put in force between two ticks, then saved for the next start.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import structlog

from orbitfb.app.commands.arguments import number, plane_of, switches, whole_number
from orbitfb.app.commands.autosave import (
    FILE,
    Saved,
    all_but,
    names_off,
    read_saved,
    write_whole,
)
from orbitfb.app.commands.base import Base
from orbitfb.app.commands.bumps import Bumps
from orbitfb.app.commands.references import load_reference, reference_file, save_reference
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.retry import EVERY, Retry
from orbitfb.core.signals import Mask, Vector
from orbitfb.learn.builders import remasked
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import MOST_AVERAGED
from orbitfb.loop.slot import PolicySlot

_log = structlog.stdlib.get_logger("orbitfb.control.server")

LARGEST_GAIN = 1.0
"""A policy is judged with its own gain; operators may only take some of it away."""


class Adjuster:
    """Carries the commands out; called from the control socket's threads.

    Args:
        base: What the adjustments start from.
        runner: The loop.
        slot: Its policy.
        dither: Its dither.
        saved_late: Told that what could not be saved at once is saved.
        every: Time between two tries to save what could not be saved [s].
    """

    def __init__(
        self,
        base: Base,
        runner: Runner,
        slot: PolicySlot,
        dither: Dither,
        saved_late: Callable[[], None] = lambda: None,
        every: float = EVERY,
    ) -> None:
        self._base, self._runner, self._slot, self._dither = base, runner, slot, dither
        self._lock = threading.Lock()
        self._correctors = np.ones(len(base.channels.correctors), dtype=np.bool_)
        self._gain = dict.fromkeys(base.channels.planes, 1.0)
        self._dither_cost: float | None = None
        self._average: int | None = None
        self._dead_band: dict[str, float] | None = None
        self._reference_name = ""
        self._bumps = Bumps(
            base.ring, base.channels, base.limits, lambda: self.movable, base.crossed
        )
        self._saving = Retry(self._save_all, _say_unsaved, saved_late, every, "settings")

    @property
    def unsaved(self) -> bool:
        """Whether something is in force that a restart would not find."""
        return self._saving.pending

    def close(self) -> None:
        """Try once more to save what could not be saved."""
        self._saving.stop()

    @property
    def handlers(self) -> dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]:
        """The commands by name."""
        return {
            "gain": self._locked(self._set_gain),
            "reference": self._locked(self._set_reference),
            "reference-save": self._locked(self._save_reference),
            "reference-load": self._locked(self._load_reference),
            "bump": self._locked(self._set_bump),
            "enable-bpms": self._locked(self._enable_bpms),
            "enable-correctors": self._locked(self._enable_correctors),
            "dither": self._locked(self._set_dither),
            "average": self._locked(self._set_average),
            "dead-band": self._locked(self._set_dead_band),
        }

    @property
    def movable(self) -> Mask:
        """Correctors that may move now, shape (m,)."""
        return self._base.movable & self._correctors

    def shown(self) -> dict[str, Any]:
        """Give what is in force, by PV of the panel, in its units."""
        wanted = self._runner.adjustments
        return {
            **{f"Gain{plane.upper()}-RB": gain for plane, gain in self._gain.items()},
            "Reference-RB": (self._runner.reference * 1e3).tolist(),
            "ReferenceName-I": self._reference_name,
            "BpmEnable-RB": (wanted.enabled & self._base.counting).astype(int).tolist(),
            "CorrectorEnable-RB": self.movable.astype(int).tolist(),
            "Dither-RB": self._dither.orbit_cost * 1e6,
            "Average-RB": wanted.average,
            **{f"DeadBand{its.upper()}-RB": band * 1e6 for its, band in self._dead_bands.items()},
            **self._bumps.shown(),
        }

    def restore(self) -> bool:
        """Take up what was saved; say whether there was anything.

        Raises:
            ConfigError: It is damaged, or of another ring.
        """
        channels = self._base.channels
        saved = read_saved(self._base.directory, channels, LARGEST_GAIN)
        if saved is None:
            return False
        self._gain.update(saved.gain)
        self._reference_name = saved.reference_name
        self._correctors = all_but(
            channels.correctors, channels.corrector_planes, saved.disabled_correctors
        )
        reference = self._base.reference(saved.reference)
        enabled = all_but(channels.bpms, channels.bpm_planes, saved.disabled_bpms)
        self._base.check_enabled(enabled, self._correctors)
        self._bumps.restore(saved.bumps, reference)
        self._average, self._dead_band = saved.average, saved.dead_band
        more: dict[str, Any] = {} if saved.average is None else {"average": saved.average}
        if saved.dead_band is not None:
            more["dead_band"] = tuple(saved.dead_band[plane] for plane in self._gain)
        self._apply(reference=reference, enabled=enabled, **more)
        if saved.dither is not None:
            self._dither_cost = saved.dither
            self._dither.retune(saved.dither)
        self._redress()
        return True

    def _locked(
        self, handler: Callable[[Mapping[str, Any]], Mapping[str, Any]]
    ) -> Callable[[Mapping[str, Any]], Mapping[str, Any]]:
        def handle(request: Mapping[str, Any]) -> Mapping[str, Any]:
            with self._lock:
                answer = handler(request)
                try:
                    self._save()
                except OrbitFeedbackError as error:  # in force all the same; a full disk, say
                    self._saving.ask()
                    told = f"in force, but not saved yet (saving is tried again): {error}"
                    return {**answer, "warning": told}
                return answer

        return handle

    def _set_gain(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        value = number(request, "value", 0.0, LARGEST_GAIN)
        self._gain[plane_of(request, self._gain)] = value
        self._apply()
        return {"gain": dict(self._gain)}

    def _set_reference(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        values = request.get("values")
        reference = self._base.reference(values if isinstance(values, list) else ())
        self._reference_name = ""
        self._apply(reference=reference)
        rms = float(np.sqrt(np.mean(reference**2)) * 1e6)
        return {"reference_rms_um": rms, **self._without_bumps()}

    def _save_reference(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        path = reference_file(self._base.directory, request.get("name"))
        save_reference(path, self._runner.adjustments.reference, self._base.channels)
        self._reference_name = path.stem
        return {"saved": str(path)}

    def _load_reference(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        path = reference_file(self._base.directory, request.get("name"))
        self._apply(reference=self._base.reference(load_reference(path, self._base.channels)))
        self._reference_name = path.stem
        return {"loaded": str(path), **self._without_bumps()}

    def _without_bumps(self) -> dict[str, int]:
        """Forget the bumps of a reference that is another one now."""
        return {"bumps_gone": gone} if (gone := self._bumps.forget()) else {}

    def _set_bump(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        before = self._runner.adjustments.reference
        change = self._bumps.asked(request, before)
        if change is None:
            return {"place": self._bumps.place}
        self._apply(reference=self._base.reference(change.reference.tolist()))
        self._bumps.take(change)
        self._reference_name = ""
        return change.told(before)

    def _enable_bpms(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        enabled = switches(request, len(self._base.channels.bpms))
        self._base.check_enabled(enabled, self._correctors)
        self._solve(enabled)
        self._apply(enabled=enabled)
        return {"bpms": int(np.count_nonzero(enabled & self._base.counting))}

    def _enable_correctors(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        enabled = switches(request, len(self._base.channels.correctors))
        self._base.check_enabled(self._runner.adjustments.enabled, enabled)
        self._correctors = enabled
        self._redress()
        return {"correctors": int(np.count_nonzero(self.movable))}

    def _set_dither(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        cost = number(request, "orbit_cost", 0.0, self._base.limits.dither_limit)
        self._dither_cost = cost
        self._dither.retune(cost)
        return {"orbit_cost": cost}

    def _set_average(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        self._average = whole_number(request, "orbits", 1, MOST_AVERAGED)
        self._apply(average=self._average)
        return {"average_orbits": self._average}

    def _set_dead_band(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        value = number(request, "value", 0.0, self._base.limits.dead_band_limit)
        bands = self._dead_band = {**self._dead_bands, plane_of(request, self._gain): value}
        self._apply(dead_band=tuple(bands.values()))
        return {"dead_band_um": {its: band * 1e6 for its, band in bands.items()}}

    @property
    def _dead_bands(self) -> dict[str, float]:
        """Dead bands by plane [m]."""
        bands = self._runner.adjustments.dead_band or (0.0,) * len(self._gain)
        return dict(zip(self._gain, bands, strict=True))

    def _apply(
        self, reference: Vector | None = None, enabled: Mask | None = None, **more: Any
    ) -> None:
        wanted = self._runner.adjustments
        planes = self._base.channels.corrector_planes
        self._runner.adjust(
            replace(
                wanted,
                gain=np.array([self._gain[plane] for plane in planes]),
                reference=wanted.reference if reference is None else reference,
                enabled=wanted.enabled if enabled is None else enabled,
                **more,
            )
        )

    def _redress(self) -> None:
        movable = self.movable
        self._slot.redress(lambda policy: remasked(policy, movable))
        self._dither.retune(movable=movable)
        self._solve(self._runner.adjustments.enabled)

    def _solve(self, enabled: Mask) -> None:
        """Have the law for these BPMs solved here and not in the middle of a tick."""
        policy = self._slot.acting
        nothing = np.zeros(len(enabled))
        policy.act(nothing, enabled & self._base.counting, policy.initial_state())

    def _save_all(self) -> None:
        """Save what is in force, from another thread than the commands'."""
        with self._lock:
            self._save()

    def _save(self) -> None:
        wanted, channels = self._runner.adjustments, self._base.channels
        saved = Saved(
            planes=channels.planes,
            gain=self._gain,
            reference=tuple(wanted.reference.tolist()),
            reference_name=self._reference_name,
            average=self._average,
            dead_band=self._dead_band,
            bumps=tuple(self._bumps.in_force.values()),
            disabled_bpms=names_off(channels.bpms, channels.bpm_planes, wanted.enabled),
            disabled_correctors=names_off(
                channels.correctors, channels.corrector_planes, self._correctors
            ),
            dither=self._dither_cost,
        )
        write_whole(self._base.directory / FILE, saved)


def _say_unsaved(error: OrbitFeedbackError) -> None:
    _log.error("settings_not_saved", problem=str(error))
