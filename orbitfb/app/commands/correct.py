"""One correction of an open loop: computed, looked at, applied, undone."""

import threading
from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any

import numpy as np
import structlog

from orbitfb.app.commands.correction import BASELINE, Preview, Sources, compute, expected, rms_of
from orbitfb.app.commands.preview import Handler
from orbitfb.core.errors import ControlError
from orbitfb.core.ports import Clock
from orbitfb.core.signals import LoopState
from orbitfb.loop.correction.hand import Done
from orbitfb.loop.correction.move import Move
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.panel.pvs.corrections import LAWS

_log = structlog.stdlib.get_logger("orbitfb.control.server")

PATIENCE = 20.0
"""How long the answer waits for a move to be over [s]; a longer one goes on and is logged."""


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
        self._check_open("correct")
        with self._lock:
            self._preview = None
            preview = self._preview = compute(self._sources, str(law), self._clock.monotonic())
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
                "(correction.preview_age); compute it again"
            )
        if self._sources.runner.adjustments is not preview.wanted:
            raise ControlError(
                f"{name} refused: reference, gain or devices in use were changed since it was "
                "computed; compute it again"
            )
        return self._move(preview.move, None)

    def _undo(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        self._check_open("undo")
        made = self._sources.runner.hand.made
        if not made:
            raise ControlError("nothing to undo: no correction was made by hand since the start")
        last = made[-1]
        error, valid = self._sources.latest.error
        rms = rms_of(expected(self._sources, error, last.start - last.left)[valid])
        return self._move(Move(f"undo of {last.name}", last.left, last.start, rms), last)

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
            "rms_change_A": rms_of(change),
            "largest_change_A": float(np.abs(change).max()),
            "largest_at": self._sources.channels.correctors[int(np.abs(change).argmax())],
            "steps": preview.move.steps(settings.step),
            "orbit_rms_um": preview.now * 1e6,
            "predicted_rms_um": preview.move.rms * 1e6,
        }
        return figures | ({"left_out": preview.left_out} if preview.left_out else {})
