"""A simulated ring whose devices fail as they are told, and which orbits may be acted on."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

QUOTA, IN_A_ROW = 9, 2
"""BPMs that may be bad, and next to each other: the rule, told here a second time."""
CURRENT_LEAST, CURRENT_AGE = 10.0, 0.5
"""Stored current [mA] and the age of its stamp [s] beyond which nothing may be written."""
ABSENT = ("nan", "zero", "invalid", "stamp", "apart", "gone")
"""What the loop must see at once; a jump or a repeat it has to find out."""


@dataclass
class Shown:
    """One tick, as it is shown."""

    reading: np.ndarray
    true_orbit: np.ndarray
    readback: np.ndarray


class FaultyRing:
    """Wraps a simulated ring.

    Args:
        ring: It.

    Attributes:
        faults: Those that are on; each with an `id` of its own.
        board_faults: What to do to each BPM on the board: `invalid`, `stamp`, `apart`.
        good: Whether the orbit shown last may be acted on.
    """

    def __init__(self, ring: Any) -> None:
        self._ring = ring
        self.faults: list[dict[str, Any]] = []
        self.board_faults: dict[int, str] = {}
        self.gone: set[int] = set()
        self.good = True
        self.last = Shown(*(np.zeros(1) for _ in range(3)))
        self._chosen: dict[str, Any] = {}
        self._began: dict[str, float] = {}
        self._size = len(ring.channels.bpms)
        self._random = np.random.default_rng(1)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._ring, name)

    def orbit_fault(self) -> dict[str, Any] | None:
        """What the whole orbit suffers from."""
        return next((fault for fault in self.faults if "orbit" in fault), None)

    def slowness(self) -> int:
        """Ticks of which one is shown."""
        return max((fault["slow"] for fault in self.faults if "slow" in fault), default=1)

    def refusing(self) -> list[int]:
        """Correctors whose setpoint takes no puts."""
        return [index for fault in self.faults for index in fault.get("refuse", ())]

    def current_faults(self) -> list[dict[str, Any]]:
        """What the current suffers from."""
        return [fault for fault in self.faults if "current" in fault or "current_old" in fault]

    def step(self, setpoints: np.ndarray, frequency_change: float = 0.0) -> Shown:
        """Let a tick pass."""
        faults, now = list(self.faults), time.monotonic()
        known = {fault["id"] for fault in faults}
        for store in (self._chosen, self._began):
            for gone in store.keys() - known:
                del store[gone]
        for fault in faults:
            self._began.setdefault(fault["id"], now)
        actual, errors = self._powered(np.array(setpoints), faults)
        sign = next((fault["sign"] for fault in faults if "sign" in fault), 1.0)
        state = self._ring.step(sign * actual, frequency_change)
        orbit, readback = state.true_orbit.copy(), sign * state.readback
        reading = state.reading.copy()
        for fault in faults:
            if "kick" in fault:
                bump = self._chosen.setdefault(fault["id"], self._bump(fault))
                orbit += bump
                reading += bump
        shift = next((fault["shift"] for fault in faults if "shift" in fault), 0)
        reading = np.roll(reading, shift)
        for fault in faults:
            if "blind" in fault:
                blind = self._chosen.setdefault(fault["id"], reading[fault["blind"]].copy())
                noise = self._random.normal(0.0, fault["noise"], blind.shape)
                reading[fault["blind"]] = blind + noise
            if "deaf" in fault:
                readback[fault["deaf"]] = setpoints[fault["deaf"]]
        self._misread(reading, faults)  # what is shown of it: a blind BPM may read NaN, too
        for index, error in errors.items():
            readback[index] += error
        self.good = self._may_act(faults, now)
        self.last = Shown(reading, orbit, readback)
        return self.last

    def _powered(self, actual: np.ndarray, faults: list[dict[str, Any]]) -> tuple[np.ndarray, dict]:
        errors: dict[int, float] = {}
        for fault in faults:
            if "deaf" in fault:
                held = self._chosen.setdefault(fault["id"], actual[fault["deaf"]].copy())
                actual[fault["deaf"]] = held
            if "corrector" not in fault:
                continue
            if fault["id"] not in self._chosen:
                strongest = np.argsort(-np.abs(actual))[fault["ranks"]]
                self._chosen[fault["id"]] = {int(i): float(actual[i]) for i in strongest}
            for index, held in self._chosen[fault["id"]].items():
                told = fault["corrector"]
                if told == "stuck":
                    actual[index] = held
                elif told == "off":
                    actual[index] = 0.0
                else:
                    errors[index] = np.nan if told == "away" else float(told)
        return actual, errors

    def _bump(self, fault: dict[str, Any]) -> np.ndarray:
        """An orbit that correctors can make, so that a loop can repair it."""
        rng = np.random.default_rng(int(fault["kick"] * 1e9))
        orbit = self._ring.nominal_response @ rng.normal(size=len(self._ring.channels.correctors))
        return orbit * fault["kick"] / np.sqrt(np.mean(orbit**2))

    def _misread(self, reading: np.ndarray, faults: list[dict[str, Any]]) -> None:
        before, board, gone = self.last.reading, {}, set()
        for fault in faults:
            for key, told in fault.get("bpms", {}).items():
                index = int(key)
                if told == "zero":
                    reading[index] = 0.0
                elif told == "nan":
                    reading[index] = np.nan
                elif told == "frozen" and len(before) == self._size:
                    reading[index] = before[index]
                elif told == "gone":
                    gone.add(index)
                elif isinstance(told, float):
                    reading[index] += told
                else:
                    board[index] = told
            if fault.get("orbit") == "frozen" and len(before) == self._size:
                reading[:] = before
            elif fault.get("orbit") == "zero":
                reading[:] = 0.0
            elif fault.get("orbit") == "torn":
                board.update(dict.fromkeys(fault["which"], "stamp"))
        self.board_faults, self.gone = board, gone

    def _may_act(self, faults: list[dict[str, Any]], now: float) -> bool:
        bad = np.zeros(self._size, dtype=bool)
        hidden = any("current_old" in fault for fault in faults)  # nobody can see what it is
        for fault in faults:
            if "orbit" in fault:
                return False
            if "current_old" in fault and now - self._began[fault["id"]] > CURRENT_AGE:
                return False
            if "current" in fault and not hidden:
                known = fault["current"]
                if known is None or known < CURRENT_LEAST:
                    return False
            for key, told in fault.get("bpms", {}).items():
                bad[int(key)] |= told in ABSENT
        return int(bad.sum()) <= QUOTA and not _too_many_in_a_row(bad)


def _too_many_in_a_row(bad: np.ndarray) -> bool:
    rows = [np.roll(bad, -step) for step in range(IN_A_ROW + 1)]
    return bool(np.logical_and.reduce(rows).any())
