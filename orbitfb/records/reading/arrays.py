"""Check the arrays of the exchange format, and turn them into SI."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.errors import RecordError
from orbitfb.core.signals import Mask, Vector
from orbitfb.records.finding import Finding, listed
from orbitfb.records.reading.auxiliary import slow_channels
from orbitfb.records.reading.holes import without_holes
from orbitfb.records.reading.metadata import Meta
from orbitfb.records.reading.raw import CURRENTS, NUMBERS, VECTORS, Raw
from orbitfb.records.reading.stretches import FEWEST_ROWS, Transition
from orbitfb.records.reading.times import time_of

_NEEDED = ("orbit", "bpm_names", "corr_names")
_EXACT = 1e-6
"""Share of the largest value by which equal numbers may differ after a change of their type."""

_LARGEST = 1e30
"""Beyond any measurement, whatever its unit; the inverse is below any."""

_NOWHERE = 0.2


def transitions_from(raw: Raw, meta: Meta) -> tuple[Transition, list[Finding]]:
    """Check arrays and turn them into transitions.

    Args:
        raw: The arrays.
        meta: Units and period.

    Raises:
        RecordError: An array is missing or wrong; the message names it and the row.
    """
    _check_present(raw)
    shapes = _check_shapes(raw)
    rows = shapes[0]
    given = raw
    raw, keep, found = without_holes(given, rows, lambda name: _not_finite(given, name))
    for name in NUMBERS:
        if name in raw.numbers:
            _check_size(raw, name)
    scaled = {
        name: raw.numbers[name] * meta.factor(raw, name)
        for name in NUMBERS
        if name in raw.numbers and name != "model_R"
    }
    time = time_of(raw, scaled.get("t"), rows, meta.period)
    if "t" not in scaled:
        found.append(_made("t", f"rows are taken to be {meta.period:g} s apart, without gaps"))
    made = "next_orbit" not in scaled
    if made:
        found.append(_made("next_orbit", "the orbit of the row after it is taken instead"))
        scaled["next_orbit"] = np.roll(scaled["orbit"], -1, axis=0)
        follows = np.ones(rows - 1, dtype=np.bool_)
    else:
        follows = _following(raw, scaled["orbit"], scaled["next_orbit"])
    _complete_currents(scaled, follows, found)
    auxiliary, told = slow_channels(raw, meta, scaled, rows)
    found += told
    transition = Transition(
        time=time,
        orbit=scaled["orbit"],
        next_orbit=scaled["next_orbit"],
        setpoints=scaled["setpoint"],
        requested=scaled["action"],
        follows=follows,
        readback=scaled.get("readback"),
        dither=scaled.get("dither"),
        reference=_reference(scaled, rows) if "reference" in scaled else None,
        auxiliary=auxiliary,
    )
    if made:  # the last row has no row after it
        keep[-1] = False
    if not keep.all():
        transition = transition.take(keep)
    if len(transition) < FEWEST_ROWS:
        raise raw.wrong(
            "orbit", f"has {len(transition)} rows", f"a diagnosis needs {FEWEST_ROWS}, better 1000"
        )
    return transition, found


def _check_present(raw: Raw) -> None:
    there = {*raw.numbers, *raw.texts}
    missing = [name for name in _NEEDED if name not in there]
    if not {"action", "setpoint"} & there:
        missing.append("action (or setpoint)")
    if missing:
        raise RecordError(
            f"{raw.path}: array {', '.join(missing)} is missing (there are: "
            f"{', '.join(sorted(there)) or 'none'}); add it, see the format of records"
        )


def _check_shapes(raw: Raw) -> tuple[int, int, int]:
    """See that all arrays fit together, shape (T, n, m) of the record."""
    orbit = raw.numbers["orbit"]
    moved = _trusted(raw)
    for name, names in (("orbit", "bpm_names"), (moved, "corr_names")):
        shape, devices = raw.numbers[name].shape, len(raw.texts[names])
        if len(shape) != 2 or 0 in shape:
            raise raw.wrong(
                name,
                f"has shape {shape}",
                "give one row per tick (at least one) and one column per device",
            )
        if shape[0] == devices != shape[1]:
            raise raw.wrong(
                name,
                f"has shape {shape}, and {names} has {devices} names: its rows are devices",
                "transpose it, and every other array that lies so: rows are ticks",
            )
    rows, n = orbit.shape
    m = raw.numbers[moved].shape[1]
    wanted: dict[str, tuple[int, ...]] = dict.fromkeys(VECTORS, (rows, n))
    wanted |= dict.fromkeys(CURRENTS, (rows, m))
    wanted |= dict.fromkeys(("t", "current", "rf"), (rows,)) | {"model_R": (n, m)}
    for name, shape in wanted.items():
        if name not in raw.numbers or raw.numbers[name].shape == shape:
            continue
        if name == "reference" and raw.numbers[name].shape == (n,):
            continue
        turned = raw.numbers[name].shape == shape[::-1] and len(shape) == 2
        raise raw.wrong(
            name,
            f"has shape {raw.numbers[name].shape}, but orbit {orbit.shape} and {moved} "
            f"{raw.numbers[moved].shape} call for {shape}",
            "transpose it" if turned else "give one row per tick and one column per device"
            if name != "model_R" else "give one row per BPM and one column per corrector",
        )  # fmt: skip
    return rows, n, m


def _trusted(raw: Raw) -> str:
    """Choose which of action and setpoint the other arrays of correctors are held against.

    The one with a row for every orbit and a column for every name, and for every one of the model.
    """
    there = [name for name in ("action", "setpoint") if name in raw.numbers]
    model = raw.numbers.get("model_R", np.zeros(0)).shape

    def agreeing(name: str) -> int:
        rows, *columns = raw.numbers[name].shape
        right = (rows == len(raw.numbers["orbit"]), columns == [len(raw.texts["corr_names"])])
        return sum(right) + (columns == [*model[1:]])

    return max(there, key=agreeing)


def _not_finite(raw: Raw, name: str) -> RecordError:
    """Say which values of an array are missing that nothing can stand for."""
    values = raw.numbers[name]
    bad = ~np.isfinite(values)
    where = np.argwhere(bad)[0]
    column = _column(raw, name, int(where[1])) if values.ndim == 2 else ""
    advice = "save what was read, or leave out what has no numbers"
    if name == "model_R":
        column = f", column {where[1]} ({_pair(raw, *where)})"
        advice = "rows are BPMs, columns are correctors: give the response of each to each, or "
        advice += "leave the device without one out of every array"
    elif values.ndim == 2 and len(gone := np.flatnonzero(bad.all(axis=0))):
        kind, names = ("BPM", "bpm_names") if name in VECTORS else ("corrector", "corr_names")
        dead = [raw.texts[names][i] for i in gone if i < len(raw.texts[names])]
        column += f", and so column {gone[0]} in every row" if where[1] != gone[0] else ""
        advice = (
            f"leave the {kind} without readings ({listed(dead)}) out: its column of every array, "
            f"its name in {names}, its {'row' if kind == 'BPM' else 'column'} of model_R"
        )
    return raw.wrong(
        name,
        f"is {values[tuple(where)]} in row {where[0]}{column} ({int(bad.sum())} such values)",
        advice,
    )


def _pair(raw: Raw, row: int, column: int) -> str:
    """Name the BPM and the corrector of an element of the model."""
    sides = (("bpm_names", row), ("corr_names", column))
    return ", ".join(raw.texts[name][i] for name, i in sides if i < len(raw.texts[name]))


def _check_size(raw: Raw, name: str) -> None:
    """See that squares of the values are numbers, and not all zero."""
    values = raw.numbers[name]
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    if largest and not 1.0 / _LARGEST < largest < _LARGEST:
        raise raw.wrong(
            name,
            f"has {largest:.3g} as its largest value",
            "no unit makes that a measurement; save what was read",
        )


def _column(raw: Raw, name: str, column: int) -> str:
    array = "bpm_names" if name in VECTORS else "corr_names"
    names = raw.texts.get(array, ())
    device = f" ({names[column]})" if name != "model_R" and column < len(names) else ""
    return f", column {column}{device}"


def _following(raw: Raw, orbit: Vector, next_orbit: Vector) -> Mask:
    """Tell whether next_orbit of a row is the orbit of the row after it, shape (T - 1,)."""
    exact = _EXACT * max(float(np.nanmax(np.abs(orbit), initial=0.0)), 1e-12)
    same = ~(np.abs(orbit[1:] - next_orbit[:-1]) > exact)  # what has no number says nothing
    follows: Mask = np.all(same, axis=1)
    if len(follows) == 0 or follows.mean() >= _NOWHERE:
        return follows
    columns = np.flatnonzero(same.mean(axis=0) < _NOWHERE)
    if 0 < len(columns) <= max(1, same.shape[1] // 2):
        row = int(np.flatnonzero(~same[:, columns[0]])[0])
        raise raw.wrong(
            "next_orbit",
            f"is not the next orbit in {len(columns)} columns, first row {row}"
            f"{_column(raw, 'next_orbit', int(columns[0]))}",
            "save the orbit that was read one tick after the action",
        )
    row = int(np.flatnonzero(~follows)[0])
    guess = "it is of other ticks or in another order"
    for lag, text in ((0, "it is orbit itself"), (-1, "it is the orbit before"), (2, "it is late")):
        if _lagged(orbit, next_orbit, lag, exact):
            guess = text
    raise raw.wrong(
        "next_orbit",
        f"is not the next orbit: row {row} is not orbit of row {row + 1}, and so in "
        f"{int((~follows).sum())} of {len(follows)} rows; {guess}",
        "save the orbit that was read one tick after the action",
    )


def _lagged(orbit: Vector, next_orbit: Vector, lag: int, exact: float) -> bool:
    count = len(orbit) - abs(lag)
    first = orbit[max(lag, 0) :][:count]
    second = next_orbit[max(-lag, 0) :][:count]
    return bool((~(np.abs(first - second) > exact)).all(axis=1).mean() > 1 - _NOWHERE)


def _complete_currents(scaled: dict[str, Vector], follows: Mask, found: list[Finding]) -> None:
    """Make setpoints of actions or actions of setpoints when only one of them is there."""
    if "setpoint" not in scaled:
        action = scaled["action"]
        scaled["setpoint"] = np.cumsum(action, axis=0) - action
        found.append(
            _made(
                "setpoint",
                "the actions are added up from zero: effects of the absolute current "
                "(saturation, quantisation, hysteresis) are only judged roughly",
            )
        )
    elif "action" not in scaled:
        step = np.full_like(scaled["setpoint"], np.nan)
        step[:-1][follows] = np.diff(scaled["setpoint"], axis=0)[follows]
        scaled["action"] = step  # NaN where no next row tells it
        found.append(
            _made(
                "action",
                "the change of setpoint is taken instead, and the last row of every stretch is "
                "left out: lost writes do not show",
            )
        )


def _made(array: str, text: str) -> Finding:
    return Finding("missing-array", "note", (), None, f"array '{array}' is missing; {text}")


def _reference(scaled: dict[str, Vector], rows: int) -> Vector:
    reference = scaled["reference"]
    return np.tile(reference, (rows, 1)) if reference.ndim == 1 else reference


def dropped_columns(keep: Mask, labels: Sequence[str], shares: Vector) -> Finding:
    """Say which BPMs are left out because they are invalid too often."""
    gone = [int(column) for column in np.flatnonzero(~keep)]
    worst = max(gone, key=lambda column: float(shares[column]))
    return Finding(
        "bpm-dropped",
        "warning",
        tuple(labels[column] for column in gone),
        None,
        f"{len(gone)} BPMs are not valid too often ({labels[worst]}: in "
        f"{100 * float(shares[worst]):.0f} % of the rows) and are left out",
    )
