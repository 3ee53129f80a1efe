"""Goodness of fit: what is left of a record when all causes are in the model should be white.

Every test compares its largest value over all channels and lags with a limit from theory: the
value that a right model exceeds with a probability of `RATE` over the number of tests, shared out
among everything that the largest is taken of (Bonferroni), and beyond it a stated tolerance for
what no floor has right: noise of devices that differs by a few per cent, drift that is not quite a
random walk. No limit is tuned to cases.
"""

from collections.abc import Callable

import numpy as np
from scipy import stats

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import Audit, GoodnessTest
from orbitfb.diagnose.answer_values import numbers
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.gap_maps import lagged, projected
from orbitfb.diagnose.gof_follow import follow_tests
from orbitfb.diagnose.gof_lines import line_tests
from orbitfb.diagnose.gof_pairs import pairs_test
from orbitfb.diagnose.gof_places import place_tests
from orbitfb.diagnose.gof_slow import slow_tests
from orbitfb.diagnose.result.naming import column_names
from orbitfb.physics.optics import Matrix

RATE = 0.01
"""How often a record without any gap may have a flag at all."""
LEVEL = 0.05
"""Relative error of the floor's variance that is tolerated, and its scatter between devices."""
COLOUR = 0.02
"""Correlation of neighbouring innovations, over all channels, that a drift with a memory makes."""
OWN_COLOUR = 0.05
"""The same of a single channel."""
TAIL = 0.1
"""Excess kurtosis over all channels that is tolerated."""
_LAGS = 5
_WINDOWS = 10
_SHOWN = 8
_QUANTILES = 301
_FEWEST = 60
_MORE_TESTS = 10


def audit(bench: Bench) -> Audit:
    """Test what the causes of a bench leave.

    Args:
        bench: The record under the causes that were found.

    Returns:
        The tests, each flagged or not; none for a record that is too short to be tested.
    """
    counted = ~bench.record.starts
    white = bench.white[counted]
    names = column_names(bench.record.layout.bpms)
    if len(white) < _FEWEST:
        return Audit()
    channels = bench.floor.by_bpm(white)
    tests = (
        _level, _by_bpm, _by_mode, _mean, _colour, _own_colour, _steered, _tails, _own_tails,
        _tick, _reading, _stationary,
    )  # fmt: skip
    rate = RATE / (len(tests) + _MORE_TESTS)
    squares = np.mean(channels**2, axis=0)
    by_row = np.zeros(len(bench.record))
    by_row[counted] = np.mean(white**2, axis=1)
    return Audit(
        tests=(
            *(test(bench, white, channels, rate) for test in tests),
            *line_tests(channels, names, rate),
            pairs_test(channels, bench.record.layout.bpms, rate),
            *place_tests(bench, white, rate),
            *follow_tests(bench, rate),
            *slow_tests(bench, rate),
        ),
        quantiles=numbers(np.quantile(white, (np.arange(_QUANTILES) + 0.5) / _QUANTILES)),
        autocorrelation=numbers([_correlation(white, lag).mean() for lag in range(1, 11)]),
        autocorrelation_limit=COLOUR + _sigmas(rate, _LAGS) / np.sqrt(white.size),
        worst_channels={names[i]: float(squares[i]) for i in np.argsort(squares)[::-1][:_SHOWN]},
        worst_ticks={str(i): float(by_row[i]) for i in np.argsort(by_row)[::-1][:_SHOWN]},
    )


Test = Callable[[Bench, Matrix, Matrix, float], GoodnessTest]


def _sigmas(rate: float, count: int) -> float:
    """Largest of so many normal numbers, of either sign, that chance exceeds at this rate."""
    return float(stats.norm.isf(rate / (2 * count)))


def _judged(name: str, value: float, limit: float, nats: float, note: str) -> GoodnessTest:
    flagged = not abs(value) <= limit
    return GoodnessTest(name=name, value=value, limit=limit, flagged=flagged, note=note, nats=nats)


def _of_variance(count: float, ratio: float) -> float:
    """Gain of the right variance of so many normal numbers, over one that is 1 / ratio of it."""
    return 0.5 * count * (ratio - 1.0 - float(np.log(ratio)))


def _of_correlation(count: int, value: float) -> float:
    """Gain of a correlation of so many normal numbers."""
    return 0.5 * count * value**2


def _level(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    value = float(np.mean(white**2)) - 1.0
    limit = LEVEL + _sigmas(rate, 1) * float(np.sqrt(2.0 / white.size))
    nats = _of_variance(white.size, 1.0 + value)
    return _judged("level of all innovations", value, limit, nats, "mean square less 1")


def _variances(
    name: str,
    columns: Matrix,
    names: tuple[str, ...],
    rate: float,
    known: Vector | float = 0.0,
    *,
    less: bool = True,
) -> GoodnessTest:
    """Variance of each channel against the others', which may scatter; too little, if so asked.

    Those that differ by what is known of them differ by that from the others too.
    """
    left = np.log(np.mean(columns**2, axis=0))
    left -= np.median(left)
    logarithm = left + known
    chance = np.sqrt(2.0 / len(columns))
    spread = 1.4826 * float(np.median(np.abs(logarithm)))
    more = np.hypot(LEVEL, np.sqrt(max(spread**2 - chance**2, 0.0)))
    worst = int(np.argmax(np.abs(logarithm) if less else logarithm))
    limit = _sigmas(rate, columns.shape[1]) * float(np.hypot(chance, more))
    note = f"logarithm of the variance over the median, {names[worst]}"
    nats = _of_variance(len(columns), float(np.exp(left[worst])))
    return _judged(name, float(logarithm[worst]), limit, nats, note)


def _by_bpm(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    names = column_names(bench.record.layout.bpms)
    return _variances("variance by BPM", channels, names, rate, bench.floor.modes.levels)


def _by_mode(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    # A mode that drifts less than its floor is the floor's affair, and no motion without a cause.
    # One that is seen at few BPMs is as loud as these are.
    names = tuple(f"mode {index}" for index in range(white.shape[1]))
    loud = np.log(np.mean(channels**2, axis=0) @ bench.floor.modes.axes**2)
    return _variances("variance by mode of the drift", white, names, rate, -loud, less=False)


def _mean(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    mean = np.mean(channels, axis=0)
    worst = int(np.argmax(np.abs(mean)))
    limit = _sigmas(rate, len(mean)) / float(np.sqrt(len(channels)))
    name = column_names(bench.record.layout.bpms)[worst]
    value = float(mean[worst])
    nats = _of_correlation(len(channels), value)
    return _judged("mean by BPM", value, limit, nats, f"in standard deviations, {name}")


def _correlation(columns: Matrix, lag: int) -> Vector:
    """Autocorrelation of every channel, shape (n,)."""
    return np.sum(columns[lag:] * columns[:-lag], axis=0) / np.sum(columns**2, axis=0)


def _colour(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    values = np.array([_correlation(channels, lag).mean() for lag in range(1, _LAGS + 1)])
    worst = int(np.argmax(np.abs(values)))
    limit = COLOUR + _sigmas(rate, _LAGS) / float(np.sqrt(white.size))
    value = float(values[worst])
    nats = _of_correlation(white.size, value)
    return _judged("autocorrelation", value, limit, nats, f"lag {worst + 1}, all BPMs")


def _own_colour(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    values = np.array([_correlation(channels, lag) for lag in range(1, _LAGS + 1)])
    lag, worst = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
    limit = OWN_COLOUR + _sigmas(rate, values.size) / float(np.sqrt(len(white)))
    note = f"lag {lag + 1}, {column_names(bench.record.layout.bpms)[worst]}"
    value = float(values[lag, worst])
    nats = _of_correlation(len(white), value)
    return _judged("autocorrelation by BPM", value, limit, nats, note)


def _steered(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    """Correlation with what each corrector did one to five ticks ago."""
    record = bench.record
    scores: list[Vector] = []
    for lag in range(_LAGS):
        course = lagged(record, lag) - lagged(record, lag + 1)
        slope, size = projected(bench, bench.white, course)
        known = size > 1e-9
        scores.append(np.where(known, slope / np.sqrt(np.where(known, size, 1.0)), 0.0))
    values = np.array(scores)
    lag, worst = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
    note = f"standard deviations, lag {lag + 1}, "
    note += column_names(record.layout.correctors)[worst]
    limit = _sigmas(rate, values.size) * (1.0 + LEVEL)
    value = float(values[lag, worst])
    name = "correlation with changes of a corrector"
    return _judged(name, value, limit, 0.5 * value**2, note)


def _tails(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    own = channels / np.sqrt(np.mean(channels**2, axis=0))
    limit = TAIL + _sigmas(rate, 1) * float(np.sqrt(24.0 / white.size))
    value = float(np.mean(own**4)) - 3.0
    return _judged("excess kurtosis", value, limit, white.size * value**2 / 48.0, "all BPMs")


def _own_tails(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    """Kurtosis of each channel, as a normal number (F. J. Anscombe and W. J. Glynn, 1983)."""
    values = stats.kurtosistest(channels, axis=0).statistic
    worst = int(np.argmax(np.abs(values)))
    note = f"standard deviations, {column_names(bench.record.layout.bpms)[worst]}"
    limit = _sigmas(rate, len(values)) * (1.0 + LEVEL)
    value = float(values[worst])
    return _judged("kurtosis by BPM", value, limit, 0.5 * value**2, note)


def _tick(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    rows, count = white.shape
    total = np.sum(white**2, axis=1) / np.mean(white**2)
    worst = int(np.argmax(total))
    limit = float(stats.chi2.isf(rate / rows, count)) * (1.0 + LEVEL)
    row = int(np.flatnonzero(~bench.record.starts)[worst])
    value = float(total[worst])
    nats = _of_variance(count, value / count)
    return _judged("largest tick", value, limit, nats, f"sum of squares, row {row}")


def _reading(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    own = np.abs(channels) / np.sqrt(np.mean(channels**2, axis=0))
    row, worst = np.unravel_index(int(np.argmax(own)), own.shape)
    limit = _sigmas(rate, own.size) * (1.0 + LEVEL)
    place = int(np.flatnonzero(~bench.record.starts)[row])
    note = f"standard deviations, row {place}, {column_names(bench.record.layout.bpms)[worst]}"
    value = float(own[row, worst])
    return _judged("largest reading", value, limit, _of_variance(1.0, value**2), note)


def _stationary(bench: Bench, white: Matrix, channels: Matrix, rate: float) -> GoodnessTest:
    """Variance of each channel in parts of the record, against its own over the whole."""
    own = channels**2 / np.mean(channels**2, axis=0)
    pieces = np.array_split(own, _WINDOWS)
    values = np.array([piece.mean(axis=0) for piece in pieces])
    rows = min(len(piece) for piece in pieces)
    part, worst = np.unravel_index(int(np.argmax(values)), values.shape)
    limit = float(stats.chi2.isf(rate / values.size, rows)) / rows * (1.0 + LEVEL)
    note = f"variance over that of all, window {part + 1}, "
    note += column_names(bench.record.layout.bpms)[worst]
    value = float(values[part, worst])
    return _judged("steadiness by BPM", value, limit, _of_variance(rows, value), note)
