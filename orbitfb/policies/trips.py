"""Which policy was in force when the loop tripped: a subscriber of the loop that tells the store.

The trip is the policy's unless the beam was lost, somebody else moved the correctors, or the loop
had written nothing for a tick: a loop that is HELD does not act.
"""

import threading

import numpy as np

from orbitfb.core.retry import EVERY, Retry
from orbitfb.core.signals import LoopState, TickRecord
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.safety.interlocks import InterlockSettings, stored_current
from orbitfb.safety.second_controller import are_moved
from orbitfb.safety.verdict import Action


class TripNotes:
    """Puts on record which policies tripped the loop; the disk is no concern of the tick.

    Args:
        store: Where it is put on record.
        interlocks: Tell a lost beam.
        every: Time between two tries while the store cannot be written [s].
    """

    def __init__(
        self, store: PolicyStore, interlocks: InterlockSettings, every: float = EVERY
    ) -> None:
        self._store, self._interlocks = store, interlocks
        self._last: TickRecord | None = None
        self._current = float("nan")
        self._notes: dict[str, str] = {}
        self._lock = threading.Lock()
        self.writer = Retry(self._write, every=every, name="trip-notes")
        """Tries until the store takes it."""

    def __call__(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        last, self._last = self._last, record
        before = self._current
        if record.reading is not None:
            settings = self._interlocks
            known = record.reading.auxiliary.get(settings.current_channel, before)
            self._current = known
        if record.state is not LoopState.TRIPPED or last is None:
            return
        if last.state is LoopState.CLOSED and not self._has_another_cause(record, before):
            with self._lock:
                self._notes[last.policy_id] = record.reason
            self.writer.ask()

    def close(self) -> None:
        """Write what is not written yet."""
        self.writer.stop()

    def _has_another_cause(self, record: TickRecord, before: float) -> bool:
        if record.reading is None:
            return False
        others = record.reading.by_others
        if are_moved(others, np.ones_like(record.setpoints, dtype=np.bool_), self._interlocks):
            return True
        verdict = stored_current(record.reading.auxiliary, self._interlocks, before=before)
        return verdict.action is Action.TRIP

    def _write(self) -> None:
        with self._lock:
            notes = dict(self._notes)
        for identifier, reason in notes.items():
            self._store.failed(identifier, "tripped", reason)
            with self._lock:
                self._notes.pop(identifier, None)
