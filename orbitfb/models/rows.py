"""Which transitions may teach: the integrity screen before any statistics."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.names import RF_FREQUENCY, RF_STEP, RF_TOLERANCE
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.transitions import Transitions

_MOST_INVALID = 0.1


@dataclass(frozen=True, slots=True)
class Rows:
    """Transitions that may teach, in order.

    Args:
        tick: Tick of s_n, shape (T,).
        change: a_n as applied, shape (T, m) [A].
        dither: The dither's part of it, shape (T, m) [A].
        difference: s_{n+1} − s_n, shape (T, n) [m]; 0 where not valid.
        valid: Shape (T, n).
        starts: Whether a row does not continue the one before it, shape (T,).
        closed: Whether the loop was closed, shape (T,).
        left_out: How many rows were left out, by reason.
        orbit: s_n − reference, shape (T, n) [m]; 0 where not valid; None: not kept.
        policy_id: Who decided, shape (T,), strings; None: not kept.
        hertz: Step of the RF frequency that went with a_n, shape (T,) [Hz]; None: there was none.
    """

    tick: np.ndarray
    change: Vector
    dither: Vector
    difference: Vector
    valid: Mask
    starts: Mask
    closed: Mask
    left_out: Mapping[str, int]
    orbit: Vector | None = None
    policy_id: np.ndarray | None = None
    hertz: Vector | None = None

    def __len__(self) -> int:
        return len(self.tick)

    def take(self, begin: int, end: int | None = None) -> "Rows":
        """Give the rows of a range; what was left out counts on with the first."""
        left_out = self.left_out if begin == 0 else {}
        return replace(self._at(slice(begin, end)), left_out=left_out)

    def without(self, index: int) -> "Rows":
        """Drop one row; the next one begins a stretch."""
        keep: Mask = np.arange(len(self)) != index
        starts = self.starts.copy()
        if index + 1 < len(self):
            starts[index + 1] = True
        return replace(self._at(keep), starts=starts[keep])

    def _at(self, index: slice | Mask) -> "Rows":
        return Rows(
            self.tick[index],
            self.change[index],
            self.dither[index],
            self.difference[index],
            self.valid[index],
            self.starts[index],
            self.closed[index],
            self.left_out,
            None if self.orbit is None else self.orbit[index],
            None if self.policy_id is None else self.policy_id[index],
            None if self.hertz is None else self.hertz[index],
        )


def select_rows(transitions: Transitions, tolerance: float, with_rf: bool = False) -> Rows:
    """Leave out what would poison an estimate, and count it.

    Left out are rows whose next orbit is not known to answer the change (`unusable`), with
    values that are not finite (`not_finite`), with more than a tenth of the BPMs not valid
    or reading exactly what they read before (`invalid_bpms`), where a readback is away from its
    setpoint (`readback`), where somebody else moved a corrector (`foreign_change`) or the RF
    frequency of a loop that steps it (`foreign_rf`), and where the reference orbit changed
    (`reference`). Each breaks the stretch that it stands in.

    Args:
        transitions: What the loop recorded.
        tolerance: Largest |readback − setpoint| and largest unexplained change [A].
        with_rf: Whether rows in which the loop stepped the RF frequency may teach; else they are
            `unusable`.
    """
    transitions = transitions if with_rf else transitions.by_correctors()
    count = len(transitions)
    finite = np.isfinite(transitions.applied).all(axis=1)
    finite &= np.isfinite(transitions.setpoints).all(axis=1)
    readable = np.isfinite(transitions.orbit) & np.isfinite(transitions.next_orbit)
    # A BPM that reads the same to the last bit, noise and all, has not read anew.
    stuck = transitions.next_orbit == transitions.orbit
    valid = transitions.valid & readable & ~stuck
    finite &= ~(transitions.valid & ~readable).any(axis=1)
    enough = valid.mean(axis=1) >= 1.0 - _MOST_INVALID
    with np.errstate(invalid="ignore"):
        away = np.abs(transitions.readback - transitions.setpoints) > tolerance
        moved = np.diff(transitions.setpoints, axis=0) - transitions.applied[:-1]
        foreign = np.zeros(count, dtype=np.bool_)
        foreign[:-1] = (np.abs(moved) > tolerance).any(axis=1)
    consecutive = np.zeros(count, dtype=np.bool_)
    consecutive[:-1] = np.diff(transitions.tick) == 1
    stepped = np.zeros(count, dtype=np.bool_)
    stepped[:-1] = (transitions.reference[1:] != transitions.reference[:-1]).any(axis=1)
    left_out: dict[str, int] = {}
    keep = np.ones(count, dtype=np.bool_)
    for reason, bad in (
        ("unusable", ~transitions.usable),
        ("not_finite", ~finite),
        ("invalid_bpms", ~enough),
        ("readback", away.any(axis=1)),
        ("foreign_change", foreign & consecutive),
        ("foreign_rf", _foreign_rf(transitions)),
        ("reference", stepped & consecutive),
    ):
        found = int(np.sum(keep & bad))
        if found:
            left_out[reason] = found
        keep &= ~bad
    starts = transitions.starts()
    starts[1:] |= ~keep[:-1]
    difference = np.where(valid, transitions.next_orbit - transitions.orbit, 0.0)
    return Rows(
        transitions.tick[keep],
        transitions.applied[keep],
        transitions.dither[keep],
        difference[keep],
        valid[keep],
        starts[keep],
        transitions.closed[keep],
        left_out,
        np.where(valid, transitions.orbit - transitions.reference, 0.0)[keep],
        transitions.policy_id[keep],
        transitions.hertz[keep] if with_rf else None,
    )


def _foreign_rf(transitions: Transitions) -> Mask:
    """Rows in which somebody else moved the RF frequency of a loop that steps it, shape (T,).

    A setpoint is not read at the instant of an orbit: what the loop put shows at the next orbit, or
    at the one after.
    """
    foreign: Mask = np.zeros(len(transitions), dtype=np.bool_)
    setpoint = transitions.auxiliary.get(RF_FREQUENCY)
    if setpoint is None or RF_STEP not in transitions.auxiliary or len(transitions) < 2:
        return foreign
    moved, own = np.diff(setpoint), transitions.hertz[:-1]
    before = np.append(0.0, own[:-1])
    explained = (np.zeros(len(own)), own, before, own + before)
    with np.errstate(invalid="ignore"):
        away = np.stack([np.abs(moved - one) > RF_TOLERANCE for one in explained]).all(axis=0)
    foreign[:-1] = away & (np.diff(transitions.tick) == 1)
    return foreign
