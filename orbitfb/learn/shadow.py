"""A candidate beside the incumbent, on live orbits, without acting.

After every closed tick it is known which orbit came of the incumbent's change. What the
candidate would have made of it differs by R̂ times the difference of the two changes, so that
the orbit it would have left is

    ê_{n+1} = e_{n+1} + R̂ (a^c_n − a^i_n).

The reading noise of e_{n+1} is not the one that both laws answered to, so that the comparison
of ê with e is fair, one step at a time. The incumbent's change is the one that was applied, less
the dither.
"""

import numpy as np

from orbitfb.core.ports import Policy, inform
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.learn.judge import Verdict
from orbitfb.learn.settings import ShadowSettings
from orbitfb.safety.limits import LimitSettings, limit

_UM = 1e6


class Shadow:
    """One candidate on trial.

    Args:
        candidate: Does not act yet.
        incumbent: Acts; the trial is void when another policy does.
        response: R̂ of the candidate, shape (n, m) [m/A].
        settings: How long, how good.
        limits: Of a write.
        since: First tick that counts.
        now: Monotonic [s].
        least: Least orbit that the incumbent must leave for the model to be believed, rms [m]: a
            candidate that is expected to leave many times what is seen was made of a response
            that is not that of the ring.
    """

    def __init__(
        self,
        candidate: Policy,
        incumbent: Policy,
        response: Vector,
        settings: ShadowSettings,
        limits: LimitSettings,
        since: int,
        now: float,
        least: float = 0.0,
    ) -> None:
        self.candidate, self.incumbent = candidate, incumbent
        self.next_tick = since
        self._response, self._settings, self._limits = response, settings, limits
        self._state = candidate.initial_state()
        self._fresh, self._least = now, least
        self._ours: list[float] = []
        self._theirs: list[float] = []
        self._sizes: list[float] = []
        self._refusal = ""

    @property
    def figures(self) -> dict[str, float]:
        """What was seen, SI."""
        if not self._ours:
            return {"shadow_ticks": 0.0}
        ours, theirs = _root_mean(self._ours), _root_mean(self._theirs)
        return {
            "shadow_ticks": float(len(self._ours)),
            "shadow_rms_candidate": ours,
            "shadow_rms_incumbent": theirs,
            "shadow_change_rms": _root_mean(self._sizes),
        }

    def take(self, transitions: Transitions, now: float) -> None:
        """Let the candidate look at what has happened.

        Args:
            transitions: Those since `next_tick`.
            now: Monotonic [s].
        """
        usable = transitions.closed & transitions.by_correctors().usable
        for row in range(len(transitions)):
            self.next_tick = int(transitions.tick[row]) + 1
            if usable[row] and not self._refusal and len(self._ours) < self._settings.ticks:
                self._fresh = now
                self._look(transitions, row)

    def verdict(self, now: float) -> Verdict | None:
        """Say what came of the trial; None while it lasts.

        Args:
            now: Monotonic [s].
        """
        seen, figures = len(self._ours), self.figures
        if self._refusal:
            return Verdict(False, self._refusal, figures)
        if seen < self._settings.ticks:
            if now - self._fresh <= self._settings.patience:
                return None
            return Verdict(
                False,
                f"in shadow it saw {seen} of {self._settings.ticks} closed ticks and then none "
                f"for {self._settings.patience:g} s; close the loop and refit again",
                figures,
            )
        ours, theirs = figures["shadow_rms_candidate"], figures["shadow_rms_incumbent"]
        compared = (
            f"a trial run of {seen} ticks gave {ours * _UM:.4f} µm rms, the running policy "
            f"{theirs * _UM:.4f} µm"
        )
        if ours > theirs * (1.0 + self._settings.margin):
            return Verdict(False, f"{compared}: worse", figures)
        if theirs < self._least:
            return Verdict(
                False,
                f"{compared}: the model expects far more than that, so it is not believed",
                figures,
            )
        return Verdict(True, compared, figures)

    def _look(self, transitions: Transitions, row: int) -> None:
        valid = transitions.valid[row]
        reference = transitions.reference[row]
        error = np.where(valid, transitions.orbit[row] - reference, 0.0)
        change, self._state = self.candidate.act(error, valid, self._state)
        applied = transitions.applied[row]
        self._state = inform(self.candidate, error, valid, applied, self._state)
        acted = applied - transitions.dither[row]
        tick = int(transitions.tick[row])
        if not np.isfinite(change).all():
            self._refusal = f"in shadow it asked for a change that is not finite (tick {tick})"
            return
        setpoints = transitions.setpoints[row]
        room = limit(change, setpoints, self._limits).scale
        if room < 1.0 and limit(acted, setpoints, self._limits).scale >= 1.0:
            self._refusal = (
                f"in shadow it asked for a change of up to {np.max(np.abs(change)):.3g} A, beyond "
                f"the limits (tick {tick}); the incumbent did not"
            )
            return
        left = (transitions.next_orbit[row] - reference)[valid]
        ours = left + (self._response @ (change - acted))[valid]
        self._ours.append(_square(ours))
        self._theirs.append(_square(left))
        self._sizes.append(_square(change))


def _square(values: Vector) -> float:
    return float(np.mean(values**2)) if values.size else 0.0


def _root_mean(squares: list[float]) -> float:
    return float(np.sqrt(np.mean(squares)))
