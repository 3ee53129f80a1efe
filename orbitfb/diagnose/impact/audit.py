"""What is left when all causes are in the model, tested against the noise that it should be.

The whitened innovations of n modes at T rows are then normal, independent, and of variance one, so
that every test has its exact distribution: χ² of a mean square, normal of a correlation, binomial
of the number beyond a bound. The limits are those that a healthy record passes in one of a hundred
cases, all places of a test together.
"""

from collections.abc import Iterator

import numpy as np
from scipy.stats import binom, chi2, norm

from orbitfb.core.signals import Vector
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.innovations import at_bpms, floor_of, whitened
from orbitfb.diagnose.impact.windows import Windows
from orbitfb.diagnose.result.blocks import Audit, GoodnessTest
from orbitfb.diagnose.result.naming import column_names
from orbitfb.diagnose.result.values import numbers
from orbitfb.estimation.transform import Matrix

CHANCE = 0.01
"""Probability with which a test flags a record that is nothing but its noise [1]."""

_LAGS = 10
"""Rows between two innovations up to which they are compared: a second at 10 Hz."""

_FAR = 4.0
"""Standard deviations beyond which a reading counts as far: one of 16,000 of normal noise."""

_SHOWN = 300
"""Quantiles that are kept of hundred thousands."""

_WORST = 8
"""BPMs and rows that are listed."""


def audit(its: Explained, windows: Windows) -> Audit:
    """Test what the causes leave.

    Args:
        its: What they add, and the floor.
        windows: Of the record.
    """
    space = its.space
    white = whitened(its.left - its.loose, its.noise, space.transform)
    errors = at_bpms(white, its.noise)
    level = np.mean(errors**2, axis=0) / floor_of(its.noise)
    echo = _echoes(white)
    names = column_names(space.signals.record.layout.bpms)
    by_row = np.mean(white**2, axis=1)
    tests = (
        *_levels(level, names, len(white)),
        _echo(echo, white.size),
        _over_time(white, windows),
        _tails(white),
    )
    rows = space.transform.step_rows()
    worst = np.argsort(-by_row)[:_WORST]
    loud = np.argsort(-level)[:_WORST]
    flat = np.sort(white, axis=None)
    kept = np.linspace(0, len(flat) - 1, min(_SHOWN, len(flat))).astype(np.intp)
    return Audit(
        tests=tests,
        quantiles=numbers(flat[kept]),
        autocorrelation=numbers(echo),
        autocorrelation_limit=_echo_limit(white.size),
        worst_channels={names[place]: float(level[place]) for place in loud},
        worst_ticks={str(int(rows[step])): float(by_row[step]) for step in worst},
    )


def _levels(level: Vector, names: tuple[str, ...], rows: int) -> Iterator[GoodnessTest]:
    """Mean square at every BPM: χ² of T rows, the largest and the smallest of n."""
    chance = CHANCE / (2.0 * len(level))
    high = float(chi2.isf(chance, rows)) / rows
    low = float(chi2.ppf(chance, rows)) / rows
    gains = 0.5 * rows * (level - 1.0 - np.log(np.maximum(level, 1e-300)))
    for name, place, limit, flagged in (
        ("loudest BPM: mean square", int(np.argmax(level)), high, level.max() > high),
        ("quietest BPM: mean square", int(np.argmin(level)), low, level.min() < low),
    ):
        yield GoodnessTest(
            name=name, value=float(level[place]), limit=limit, flagged=bool(flagged),
            note="1 is expected", nats=float(gains[place]), places=(names[place],),
        )  # fmt: skip


def _echoes(white: Matrix) -> Vector:
    """Correlation of innovations some rows apart, all modes together, shape (_LAGS,)."""
    lags = range(1, min(_LAGS, len(white) // 4) + 1)
    size = float(np.mean(white**2))
    return np.array([float(np.mean(white[lag:] * white[:-lag])) / size for lag in lags])


def _echo_limit(count: int) -> float:
    return float(norm.isf(CHANCE / (2.0 * _LAGS)) / np.sqrt(count))


def _echo(echo: Vector, count: int) -> GoodnessTest:
    lag = int(np.argmax(np.abs(echo)))
    return GoodnessTest(
        name="correlation from row to row", value=float(echo[lag]), limit=_echo_limit(count),
        flagged=bool(abs(echo[lag]) > _echo_limit(count)),
        note=f"at {lag + 1} rows; 0 is expected", nats=0.5 * count * float(echo[lag]) ** 2,
    )  # fmt: skip


def _over_time(white: Matrix, windows: Windows) -> GoodnessTest:
    """Mean square of every window: χ², the largest of them."""
    counts = windows.lengths * white.shape[1]
    level = windows.sums(np.sum(white**2, axis=1)) / counts
    chance = CHANCE / len(counts)
    surprise = chi2.logsf(level * counts, counts)
    worst = int(np.argmin(surprise))
    limit = float(chi2.isf(chance, counts[worst]) / counts[worst])
    gain = 0.5 * counts[worst] * (level[worst] - 1.0 - np.log(level[worst]))
    return GoodnessTest(
        name="loudest window: mean square", value=float(level[worst]), limit=limit,
        flagged=bool(level[worst] > limit),
        note=f"window {worst + 1} of {len(counts)}; 1 is expected", nats=max(float(gain), 0.0),
    )  # fmt: skip


def _tails(white: Matrix) -> GoodnessTest:
    """Values far out: binomial."""
    usual = 2.0 * float(norm.sf(_FAR))
    far = int(np.sum(np.abs(white) > _FAR))
    limit = int(binom.isf(CHANCE, white.size, usual))
    share = max(far, 1) / white.size
    gain = far * np.log(share / usual) - (share - usual) * white.size
    return GoodnessTest(
        name=f"values beyond {_FAR:g} σ", value=float(far), limit=float(limit),
        flagged=far > limit, note=f"{usual * white.size:.0f} are expected",
        nats=max(float(gain), 0.0) if far > usual * white.size else 0.0,
    )  # fmt: skip
