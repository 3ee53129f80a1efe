"""One correction of an open loop: computed, looked at, applied, undone."""

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np
import structlog

from orbitfb.app.commands.preview import Handler, Latest
from orbitfb.core.errors import ControlError, OrbitFeedbackError
from orbitfb.core.ports import Clock, Policy
from orbitfb.core.signals import Channels, LoopState, Mask, Vector
from orbitfb.learn.builders import masked, unmasked
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.correction.hand import Done
from orbitfb.loop.correction.move import Move
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.panel.correction_pvs import LAWS
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.bounds import Bounds

_log = structlog.stdlib.get_logger("orbitfb.control.socket")

BASELINE, ACTIVE = LAWS
"""The SVD law with gain 1, or the policy in force as it is."""
PATIENCE = 20.0
"""How long the answer waits for a move to be over [s]; a longer one goes on and is logged."""
ROUNDS = 12
"""How often correctors at a limit leave the solution, as in a tick (`loop.choice`)."""


@dataclass(frozen=True, slots=True)
class Sources:
    """What a correction is computed from.

    Args:
        channels: Of the loop.
        runner: The loop.
        slot: The policy in force.
        latest: The last orbit.
        configured: Settings of the SVD law for a policy in force that is none.
        movable: Gives the correctors that may move now, shape (m,).
        bounds: Gives the limits of the setpoints that are in force.
        settings: Of corrections.
        period: Of the loop [s].
        measured: The response that was measured, shape (n, m) [m/A]; None: that of the policy.
    """

    channels: Channels
    runner: Runner
    slot: PolicySlot
    latest: Latest
    configured: SvdSettings
    movable: Callable[[], Mask]
    bounds: Callable[[], Bounds]
    settings: CorrectionSettings
    period: float
    measured: Vector | None = None


@dataclass(frozen=True, slots=True)
class Preview:
    """A correction that was computed.

    Args:
        move: What it would do.
        now: Rms orbit error before it [m].
        made: When, monotonic [s].
        wanted: What operators wanted then.
        left_out: Correctors that stay as they would go beyond their limits; empty: none.
    """

    move: Move
    now: float
    made: float
    wanted: Adjustments
    left_out: str

    @property
    def change(self) -> Vector:
        """Change of the setpoints, shape (m,) [A]."""
        return self.move.aim - self.move.start


class Corrections:
    """Computes, applies and undoes corrections; called from the control socket's threads.

    Args:
        sources: What they are computed from.
        statistics: Gets a line for people.
        clock: Tells their age.
    """

    def __init__(self, sources: Sources, statistics: LoopStatistics, clock: Clock) -> None:
        self._sources, self._statistics, self._clock = sources, statistics, clock
        self._lock = threading.Lock()
        self._preview: Preview | None = None
        self._told = ""

    @property
    def handlers(self) -> dict[str, Handler]:
        """The commands by name."""
        return {"correct": self._correct, "correct-apply": self._apply, "undo": self._undo}

    def shown(self) -> dict[str, Any]:
        """Give what was computed and what came of it, by PV of the panel, in its units."""
        preview, channels = self._preview, self._sources.channels
        parts = channels.corrector_parts
        values: dict[str, Any] = {
            "CorrectText-I": self._told,
            "Undos-I": len(self._sources.runner.hand.made),
            "CorrectRms-I": None,
            "CorrectMax-I": None,
            "CorrectNow-I": None,
            "CorrectOrbit-I": None,
            **{f"Preview{plane.upper()}-I": None for plane in parts},
        }
        if preview is None:
            return values
        figures, change = self._figures(preview), np.round(preview.change, 7).tolist()
        return {
            **values,
            "CorrectRms-I": figures["rms_change_A"],
            "CorrectMax-I": figures["largest_change_A"],
            "CorrectNow-I": figures["orbit_rms_um"],
            "CorrectOrbit-I": figures["predicted_rms_um"],
            **{f"Preview{plane.upper()}-I": change[part] for plane, part in parts.items()},
        }

    def _correct(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        law, once = request.get("law", BASELINE), request.get("once", False)
        if law not in LAWS:
            raise ControlError(f"law must be {' or '.join(LAWS)}, not {law!r}")
        if not isinstance(once, bool):
            raise ControlError(f"once must be true or false, not {once!r}")
        with self._lock:
            self._preview = None
            preview = self._preview = self._computed(str(law))
            self._told = f"{preview.move.name} computed"
        figures = self._figures(preview)
        return {**figures, **self._apply({})} if once else figures

    def _apply(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        with self._lock:
            preview, self._preview = self._preview, None
        if preview is None:
            raise ControlError("no correction was computed since the last one: `correct` first")
        name, oldest = preview.move.name, self._sources.settings.preview_age
        if (age := self._clock.monotonic() - preview.made) > oldest:
            raise ControlError(
                f"{name} refused: it was computed {age:.0f} s ago, longer than {oldest:g} s "
                "(correction.preview_age); compute it anew"
            )
        if self._sources.runner.adjustments is not preview.wanted:
            raise ControlError(
                f"{name} refused: reference, gain or devices in use were changed since it was "
                "computed; compute it anew"
            )
        return self._move(preview.move, None)

    def _undo(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        self._check_open("undo")
        made = self._sources.runner.hand.made
        if not made:
            raise ControlError("nothing to undo: no correction was made by hand since the start")
        last = made[-1]
        error, valid = self._sources.latest.error
        expected = _rms(self._expected(error, last.start - last.left)[valid])
        return self._move(Move(f"undo of {last.name}", last.left, last.start, expected), last)

    def _move(self, move: Move, undoes: Done | None) -> Mapping[str, Any]:
        future = self._sources.runner.hand.order(move, undoes)
        future.add_done_callback(lambda outcome: self._tell(move, outcome))
        try:
            done = future.result(PATIENCE)
        except TimeoutError:
            # What was told to have failed must not be carried out later.
            if future.cancel():
                raise ControlError(
                    f"{move.name} refused: no orbit came within {PATIENCE:g} s, it is withdrawn"
                ) from None
            return {"under_way": f"{move.name} goes on; the log tells what comes of it"}
        return {
            "done": done.name,
            "steps": done.steps,
            "before_rms_um": done.before * 1e6,
            "after_rms_um": done.after * 1e6,
            "can_be_undone": len(self._sources.runner.hand.made),
        }

    def _tell(self, move: Move, outcome: Future[Done]) -> None:
        """Log what came of a move."""
        if outcome.cancelled():
            return
        largest = float(np.abs(move.aim - move.start).max())
        failure = outcome.exception()
        if failure is not None:
            self._told = str(failure)
            _log.warning("correction_ended", problem=self._told, largest_change=largest)
        else:
            done = outcome.result()
            rms = f"{done.before * 1e6:.3g} to {done.after * 1e6:.3g} µm rms"
            self._told = f"{done.name} done in {done.steps} steps: {rms}"
            _log.info(
                "correction_done",
                name=done.name,
                steps=done.steps,
                largest_change=largest,
                rms_before=done.before,
                rms_after=done.after,
            )
        self._statistics.happened("correction", self._told)

    def _computed(self, kind: str) -> Preview:
        sources = self._sources
        self._check_open("correct")
        error, valid = sources.latest.error
        record = sources.latest.record
        if record is None or record.reading is None or not valid.any():
            raise ControlError("correct refused: no BPM of the last orbit counts")
        oldest = max(2.0, 3.0 * sources.period)
        if (age := self._clock.monotonic() - record.reading.received) > oldest:
            raise ControlError(f"correct refused: the last orbit came {age:.3g} s ago")
        start = record.setpoints + record.applied
        if not np.isfinite(start).all():
            raise ControlError("correct refused: the setpoints in force are not known")
        policy = self._law(kind)
        change, full = self._solved(policy, error, valid, start)
        now, after = _rms(error[valid]), _rms(self._expected(error, change)[valid])
        name = f"correction by {policy.policy_id}"
        if not after < now:
            raise ControlError(
                f"{name} refused: the orbit error is {now * 1e6:.3g} µm rms and would be "
                f"{after * 1e6:.3g} µm after it"
            )
        left_out = sources.bounds().name(full, sources.channels.correctors) if full.any() else ""
        move = Move(name, start, start + change, after)
        wanted = sources.runner.adjustments
        return Preview(move, now, self._clock.monotonic(), wanted, left_out)

    def _solved(
        self, policy: Policy, error: Vector, valid: Mask, start: Vector
    ) -> tuple[Vector, Mask]:
        """Solve without the correctors that would go beyond their limits.

        Returns:
            The change, shape (m,) [A], and the correctors that were left out, shape (m,).
        """
        sources = self._sources
        bounds, full = sources.bounds(), np.zeros(len(start), dtype=np.bool_)
        for _ in range(ROUNDS):
            change, _ = policy.act(error, valid, policy.initial_state())
            if change.shape != start.shape or not np.isfinite(change).all():
                raise OrbitFeedbackError(f"{policy.policy_id} asks for changes that are not finite")
            size = np.abs(change)
            tight = (size > bounds.room(change, start)) & (size > 0)
            if not tight.any():
                return change, full
            full |= tight
            if not (sources.movable() & ~full).any():
                break
            policy = without(policy, full)
        names = bounds.name(full, sources.channels.correctors)
        raise ControlError(f"correct refused: {names} would go beyond their limits")

    def _law(self, kind: str) -> Policy:
        sources = self._sources
        if kind == ACTIVE:
            return sources.slot.acting
        inside: Any = unmasked(sources.slot.current)
        settings = inside.settings if isinstance(inside, SvdPolicy) else sources.configured
        whole = {"gain": 1.0, "integral_gain": 0.0, "derivative_gain": 0.0}
        law = SvdPolicy(
            inside.response,
            settings.model_copy(update=whole),
            covariance=getattr(inside, "covariance", None),
        )
        return masked(law, sources.movable())

    def _expected(self, error: Vector, change: Vector) -> Vector:
        """Give the orbit error after a change, shape (n,) [m], by what is known of the response."""
        response = self._sources.measured
        if response is None:
            response = getattr(self._sources.slot.acting, "response", None)
        if response is None:
            raise ControlError(
                "the policy in force has no response matrix, so that nothing can be predicted"
            )
        return error + response @ change

    def _check_open(self, what: str) -> None:
        state = self._sources.runner.state
        if state is LoopState.OPEN:
            return
        first = "reset" if state is LoopState.TRIPPED else "open"
        raise ControlError(f"{what} refused: the loop is {state}; `{first}` it first")

    def _figures(self, preview: Preview) -> dict[str, Any]:
        change, settings = preview.change, self._sources.settings
        figures = {
            "law": preview.move.name.removeprefix("correction by "),
            "rms_change_A": _rms(change),
            "largest_change_A": float(np.abs(change).max()),
            "largest_at": self._sources.channels.correctors[int(np.abs(change).argmax())],
            "steps": preview.move.steps(settings.step),
            "orbit_rms_um": preview.now * 1e6,
            "predicted_rms_um": preview.move.rms * 1e6,
        }
        return figures | ({"left_out": preview.left_out} if preview.left_out else {})


def _rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))
