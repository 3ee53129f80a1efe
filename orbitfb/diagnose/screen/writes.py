"""Whether setpoints are the sums of the changes asked for, and whether the clock is even."""

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask
from orbitfb.diagnose.screen.actions import other_actions
from orbitfb.diagnose.screen.steps import inner
from orbitfb.physics.optics import Matrix
from orbitfb.records.finding import Finding, counted, listed
from orbitfb.records.record import Record

_RELATIVE = 1e-6
_ABSOLUTE = 1e-10
_MOSTLY = 0.5
_NEARLY = 0.95
_ROUNDING = 0.05
_FEWEST = 10
_JITTER = 0.02
_PERIOD = 0.05


def check_writes(record: Record) -> list[Finding]:
    """Compare every change of the setpoints with what was asked for."""
    first = np.flatnonzero(inner(record) & np.isfinite(record.requested[:-1]).all(axis=1))
    if not len(first):
        return []
    asked = record.requested[first]
    done = record.setpoints[first + 1] - record.setpoints[first]
    size = np.abs(record.setpoints).max(axis=0)
    exact = _RELATIVE * size + _ABSOLUTE + 1e-7 * np.abs(asked).max(axis=0)
    differs = np.abs(done - asked) > exact
    if not differs.any():
        return []
    if shifted := _shifted(first, asked, done, exact):
        return [shifted]
    if other := other_actions(first, asked, done, exact):
        return other
    found: list[Finding] = []
    meant = np.abs(asked) > exact
    still = np.abs(done) <= exact
    # A lost write: many correctors were to move, and not one of them did.
    several = meant.sum(axis=1) >= max(2, meant.shape[1] // 2)
    lost = several & (still | ~meant).all(axis=1)
    if lost.any() and lost.mean() < _MOSTLY:
        rows = first[lost]
        text = (
            f"in {counted(int(lost.sum()), 'row')} (first {int(rows[0])}) the requested change "
            "is missing from the next setpoints of all correctors: those writes were lost"
        )
        span = (int(rows[0]), int(rows[-1]))
        found.append(Finding("lost-write", "warning", (), span, text, effect="missed-write"))
        differs &= ~lost[:, None]
    found += _stuck(record, first, still, meant, differs)
    stuck = {device for finding in found for device in finding.devices}
    names = [record.layout.correctors.label(j) for j in range(asked.shape[1])]
    differs[:, [j for j, name in enumerate(names) if name in stuck]] = False
    return found + _others(names, first, asked, done, differs)


def _shifted(first: np.ndarray, asked: Matrix, done: Matrix, exact: np.ndarray) -> Finding | None:
    """Tell a column that is off by a row: the sums fit exactly then."""
    joined = np.flatnonzero(np.diff(first) == 1)

    def fits(made: Matrix, meant: Matrix) -> bool:
        moved = np.any(np.abs(meant) > exact, axis=1)
        same = np.all(np.abs(made - meant) <= exact, axis=1)
        return int(moved.sum()) >= _FEWEST and float(same[moved].mean()) > _NEARLY

    if fits(done[joined], asked[joined + 1]):
        text = (
            "'setpoint' holds the values after the action of its row, not those in force when the "
            "orbit was read; move it by one row"
        )
        return Finding("shifted-setpoints", "failure", (), None, text)
    if fits(done[joined + 1], asked[joined]):
        text = (
            "setpoints follow the actions one row late: writes take a tick longer than the log "
            "says, or 'action' is one row early"
        )
        return Finding("shifted-setpoints", "warning", (), None, text)
    return None


def _stuck(
    record: Record, first: np.ndarray, still: Mask, meant: Mask, differs: Mask
) -> list[Finding]:
    """Find correctors whose setpoint stays, to the end of the record, though it was to move."""
    found: list[Finding] = []
    for column in np.flatnonzero((differs & still & meant).sum(axis=0) >= _FEWEST):
        moves = np.flatnonzero(~still[:, column])
        begin = int(moves[-1]) + 1 if len(moves) else 0
        wanted = int(meant[begin:, column].sum())
        if wanted < _FEWEST:
            continue
        label = record.layout.correctors.label(int(column))
        text = (
            f"the setpoint of {label} stays at {record.setpoints[-1, column]:.6g} A from row "
            f"{int(first[begin])} to the end, although {wanted} changes were requested"
        )
        span = (int(first[begin]), len(record) - 1)
        found.append(
            Finding("frozen-setpoint", "warning", (label,), span, text, effect="corrector-stuck")
        )
    return found


def _others(
    names: list[str], first: np.ndarray, asked: Matrix, done: Matrix, differs: Mask
) -> list[Finding]:
    if not differs.any():
        return []
    columns = np.flatnonzero(differs.any(axis=0))
    rows = first[differs.any(axis=1)]
    devices = tuple(names[int(column)] for column in columns)
    span = (int(rows[0]), int(rows[-1]))
    error = np.where(differs, done - asked, 0.0)
    rms = float(np.sqrt(np.mean(asked**2)))
    if float(np.abs(error).max()) < _ROUNDING * rms:
        text = (
            f"setpoints differ from the sums of the actions by at most {np.abs(error).max():.2g} A "
            "(rounding)"
        )
        return [Finding("rounded-setpoints", "note", (), None, text)]
    share = float(differs.any(axis=1).mean())
    text = (
        f"in {100 * share:.1f} % of the rows (first {span[0]}) the change of the setpoints is not "
        f"the requested action, for "
        f"{counted(len(columns), 'corrector')} ({listed(list(devices))}), by up to "
        f"{np.abs(error).max():.3g} A: limits, or something else writes too; the diagnosis "
        "uses the setpoints"
    )
    return [Finding("requested-not-applied", "warning", devices, span, text)]


def check_clock(record: Record) -> list[Finding]:
    """See whether the stamps come at even distances."""
    period = record.layout.period
    gaps = np.diff(record.time)[inner(record)]
    if not len(gaps):
        return []
    found: list[Finding] = []
    usual = float(np.median(gaps))
    if abs(usual / period - 1.0) > _PERIOD:
        text = (
            f"the time stamps are {usual:.4g} s apart, but the record states a period of "
            f"{period:.4g} s"
        )
        found.append(Finding("period", "warning", (), None, text))
    spread = TO_SIGMA * float(np.median(np.abs(gaps - usual))) / np.sqrt(2.0)
    if spread > _JITTER * usual:
        text = (
            f"the time stamps jitter by {spread * 1e3:.3g} ms rms, {100 * spread / usual:.0f} % "
            "of a period; the comparison of effects tests whether the readings do too"
        )
        found.append(Finding("stamp-jitter", "note", (), None, text))
    return found
