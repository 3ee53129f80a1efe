"""Can these numbers be what they are said to be? The optics of the ring are the measure.

A file from elsewhere is transposed, in other units, of turned sign or in another order more often
than it is subtly wrong. All of these are far from what the optics say, and each has a look of its
own: the message says which, and what to do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Channels, Vector
from orbitfb.measure.screen import MOST_SIZE, SIGN, evened, exchanges, order_told, row_sizes

ALIKE = 0.5
"""Least cosine between a matrix and that of the optics for them to be of one ring [1]."""

_OTHER_SIZE = 1.5
"""Times the median device that a row or column may be larger or smaller [1]: healthy devices of
measured rings scatter by 8 %, and three families of magnets by 17 %."""

_SCALES = (1e-6, 1e-3, 1e3, 1e6)
_NAMES = {1e-6: "a million times smaller", 1e-3: "1000 times smaller"}
_NAMES |= {1e3: "1000 times larger", 1e6: "a million times larger"}


@dataclass(frozen=True, slots=True)
class Likeness:
    """How a matrix compares with that of the optics.

    Args:
        plane: `x` or `y`.
        cosine: Between the two as vectors [1].
        size: By how much it is larger, by least squares [1].
    """

    plane: str
    cosine: float
    size: float


def likeness(first: Vector, second: Vector, plane: str = "") -> Likeness:
    """Compare a matrix with that of the optics, over what is finite."""
    both = np.isfinite(first) & np.isfinite(second)
    a, b = first[both], second[both]
    power, own = float(b @ b), float(a @ a)
    if power <= 0 or own <= 0:
        return Likeness(plane, 0.0, 0.0)
    overlap = float(a @ b)
    return Likeness(plane, overlap / np.sqrt(power * own), overlap / power)


def response_problem(
    matrix: Vector, nominal: Vector, channels: Channels, unit: str, units: Mapping[str, float]
) -> str:
    """Say what is wrong with a response matrix as a whole; "" when nothing is.

    Args:
        matrix: Shape (n, m) [m/A]; NaN where nothing was measured.
        nominal: By the optics, shape (n, m) [m/A].
        channels: Names and planes.
        unit: That the file is taken to have.
        units: All units of its kind, by size in SI.
    """
    columns = channels.corrector_parts
    for plane, rows in channels.bpm_parts.items():
        block = rows, columns[plane]
        found = likeness(matrix[block], nominal[block], plane)
        if not np.isfinite(matrix[block]).any():
            continue
        if problem := _block_problem(matrix[block], nominal[block], found, unit, units):
            return f"plane {plane}: {problem}"
    return ""


def _block_problem(
    matrix: Vector, nominal: Vector, found: Likeness, unit: str, units: Mapping[str, float]
) -> str:
    as_is = likeness(matrix, nominal).cosine
    # one row or column of another size must not decide over all: each is brought to its size
    alike = evened(matrix, nominal)
    sizes = row_sizes(matrix, nominal)
    found = replace(
        found,
        cosine=likeness(alike, nominal).cosine,
        size=float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else found.size,
    )
    square = matrix.shape[0] == matrix.shape[1]
    turned = likeness(matrix.T, nominal).cosine if square else 0.0
    if abs(turned) >= ALIKE and abs(turned) > abs(as_is) + 0.1:
        return (
            f"it looks like the optics when transposed (cosine {turned:.2f} instead of "
            f"{as_is:.2f}); give --transpose if its rows are correctors in the file, and "
            "only then"
        )
    if found.cosine > -SIGN and found.cosine < ALIKE and (told := order_told(alike, nominal)):
        return told
    if abs(found.cosine) < ALIKE:
        return (
            f"it does not look like the response of the optics (cosine {found.cosine:.2f}); its "
            "rows or columns are in another order, of the other plane, or of another ring: see "
            "where its names come from, and that --planes and --places are right"
        )
    if found.cosine < 0:
        return (
            f"it has the opposite sign of the optics (cosine {found.cosine:.2f}); a matrix here is "
            "orbit per setpoint, not the correction: turn its sign where it was made"
        )
    if not 1 / MOST_SIZE < found.size < MOST_SIZE:
        fitting = [
            other
            for other, size in units.items()
            if 1 / MOST_SIZE < found.size * size / units[unit] < MOST_SIZE
        ]
        advice = f"it would fit in {' or '.join(fitting)}" if fitting else "no unit would fit"
        return (
            f"taken in {unit} it is {found.size:.3g} times as large as the optics say; {advice}: "
            "state the unit that it was measured in"
        )
    return ""


def doubtful(matrix: Vector, nominal: Vector, labels: tuple[str, ...]) -> dict[str, str]:
    """Name the columns that do not look like those of the optics, although most do.

    Each is told for what it is: of the opposite sign, in another one's place, of another size, or
    not like the optics at all.
    """
    alike = evened(matrix, nominal)
    found: dict[str, str] = {}
    for first, second in exchanges(alike.T, nominal.T):
        for one, other in ((first, second), (second, first)):
            found[labels[one]] = (
                f"has the column of {labels[other]}: the two are exchanged; exchange their names "
                "or cables"
            )
    sizes = row_sizes(matrix.T, nominal.T)
    usual = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 1.0
    for j, label in enumerate(labels):
        if label in found or not np.isfinite(matrix[:, j]).any():
            continue
        cosine = likeness(alike[:, j], nominal[:, j]).cosine
        size = sizes[j] / usual if usual > 0 else 1.0
        if cosine <= -ALIKE:
            found[label] = (
                f"has the opposite sign of the optics (cosine {cosine:.2f}): its cables or its "
                "sign are the other way round"
            )
        elif cosine < ALIKE:
            found[label] = (
                f"does not look like what the optics say (cosine {cosine:.2f}): is it the "
                "device of that name?"
            )
        elif not 1 / _OTHER_SIZE < size < _OTHER_SIZE:
            found[label] = (
                f"is {size:.3g} times as large as the others beside the optics: its calibration, "
                "or another unit of this one?"
            )
    return found


def history_problem(orbit: Vector, setpoints: Vector, response: Vector, calibration: Vector) -> str:
    """Say what is wrong with the sizes of an orbit history; "" when nothing is.

    Args:
        orbit: Shape (T, n) [m]; NaN where not valid.
        setpoints: Shape (T, m) [A]; NaN where not known.
        response: By the optics, shape (n, m) [m/A].
        calibration: Kick per ampere of every corrector, shape (m,) [rad/A].
    """
    size = float(np.nanmedian(np.abs(orbit))) if np.isfinite(orbit).any() else np.nan
    if not 1e-10 < size < 0.02:
        return (
            f"the median reading is {size:.3g} m, which no orbit is; correct --orbit-unit "
            "(or the columns that --orbit names)"
        )
    kick = float(np.nanmax(np.abs(setpoints) * np.abs(calibration)))
    if kick > 0.02:
        return (
            f"a setpoint makes a kick of {kick:.3g} rad, which no corrector does; correct "
            "--setpoint-unit (mA instead of A?)"
        )
    steps, moved = np.diff(setpoints, axis=0), np.diff(orbit, axis=0)
    whole = np.isfinite(steps).all(axis=1) & np.isfinite(moved).all(axis=1)
    if not whole.any() or not steps[whole].any():
        return ""
    expected = steps[whole] @ response.T
    found = likeness(moved[whole], expected)
    for scale in _SCALES:
        if abs(found.cosine) > 0.3 and 1 / MOST_SIZE < abs(found.size) / scale < MOST_SIZE:
            return (
                f"the orbit answers the setpoints {_NAMES[scale]} than the optics say (cosine "
                f"{found.cosine:.2f}); correct --orbit-unit or --setpoint-unit"
            )
    return ""
