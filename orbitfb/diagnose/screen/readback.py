"""Whether the currents that are read back are the setpoints."""

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.diagnose.screen.steps import inner, runs
from orbitfb.physics.places import Indices
from orbitfb.records.finding import Finding, counted, listed
from orbitfb.records.record import Record

_WINDOW = 50
_STILL = 0.1
_FOLLOWS = 0.5
_FACTOR = 10.0
_FEWEST_AT_RAIL = 12
_BEYOND = 5.0


def check_readback(record: Record) -> list[Finding]:
    """Find correctors whose readback stands still, is clipped, or goes its own way."""
    if record.readback is None:
        return []
    rows = np.flatnonzero(inner(record))
    readback, setpoints = record.readback[rows], record.setpoints[rows]
    away = readback - setpoints
    away = away - np.median(away, axis=0)
    spread = np.sqrt(np.mean(away**2, axis=0))
    usual = float(np.median(spread))
    moving = np.std(setpoints, axis=0)
    exact = 1e-6 * np.abs(setpoints).max(axis=0) + 1e-10
    strange = (spread > _FACTOR * usual + exact) & (spread > 0.02 * moving)
    found: list[Finding] = []
    rest: list[str] = []
    for column in np.flatnonzero(strange):
        label = record.layout.correctors.label(int(column))
        pair = (setpoints[:, column], readback[:, column])
        told = _clipped(label, rows, *pair) or _stuck(label, rows, *pair)
        if told:
            found.append(told)
        else:
            rest.append(label)
    if rest:
        text = (
            f"correctors whose readback is more than {_FACTOR:.0f} times further from the setpoint "
            f"than that of the others: {listed(rest)}"
        )
        found.append(Finding("readback", "note", tuple(rest), None, text))
    if usual > 0.02 * float(np.median(moving)) and usual > float(np.median(exact)):
        found.append(_general(record, readback, setpoints, rows, usual))
    return found


def _stuck(label: str, rows: Indices, setpoint: Vector, readback: Vector) -> Finding | None:
    """Tell a readback that stands still to the end while its setpoint moves."""
    last = float(readback[-1])
    noise = TO_SIGMA * float(np.median(np.abs(np.diff(readback[-_WINDOW:])))) * 3.0
    far = np.flatnonzero(np.abs(readback - last) > noise + 1e-6 * abs(last) + 1e-12)
    begin = int(far[-1]) + 1 if len(far) else 0
    if len(readback) - begin < _WINDOW:
        return None
    travel = float(np.ptp(setpoint[begin:]))
    if travel == 0.0 or float(np.ptp(readback[begin:])) > _STILL * travel:
        return None
    # A slow random walk may stay near its last value by chance, but its setpoint stays with it.
    step = float(np.median(np.abs(np.diff(setpoint[begin:]))))
    if travel < _BEYOND * max(step, noise):
        return None
    span = (int(rows[begin]), int(rows[-1]))
    text = (
        f"the readback of {label} stays at {last:.6g} A from row {span[0]} to the end while its "
        f"setpoint moves over {travel:.3g} A: the supply does not follow"
    )
    before = readback[:begin]
    if begin and (last >= before.max() or last <= before.min()):
        text += " (stuck, or at its limit)"
        return Finding("readback-stuck", "warning", (label,), span, text)
    return Finding("readback-stuck", "warning", (label,), span, text, effect="corrector-stuck")


def _clipped(label: str, rows: Indices, setpoint: Vector, readback: Vector) -> Finding | None:
    """Tell a readback that comes again and again to one extreme, with setpoints beyond it."""
    for sign in (1.0, -1.0):
        top = float(np.max(sign * readback))
        at = sign * readback == top
        beyond = at & (sign * setpoint > top)
        inside = ~at
        if beyond.sum() < _FEWEST_AT_RAIL or beyond.sum() < 0.9 * at.sum() or not inside.any():
            continue
        apart = np.abs(readback - setpoint)
        if np.median(apart[inside]) > 0.1 * np.median(apart[beyond]):
            continue
        hit = rows[at]
        if len(runs(at)) == 1:
            continue  # stuck at its extreme, or at its limit: nobody can tell
        text = (
            f"the readback of {label} stops at {sign * top:.6g} A in "
            f"{counted(int(at.sum()), 'row')} whose "
            "setpoints go further: the supply is at its limit"
        )
        span = (int(hit[0]), int(hit[-1]))
        return Finding(
            "readback-clipped", "warning", (label,), span, text, effect="corrector-saturation"
        )
    return None


def _general(
    record: Record, readback: Vector, setpoints: Vector, rows: Indices, usual: float
) -> Finding:
    """Say how all readbacks differ, and whether a tick of delay explains it."""
    joined = np.diff(rows) == 1
    late = (readback[1:] - setpoints[:-1])[joined]
    late = late - np.median(late, axis=0)
    text = f"readbacks differ from their setpoints by {usual:.3g} A rms"
    if float(np.median(np.sqrt(np.mean(late**2, axis=0)))) < 0.1 * usual:
        text += "; they are the values of the tick before"
    return Finding("readback", "note", (), None, text)
