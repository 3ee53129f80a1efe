"""Figures in the words and units of the control room."""

import math
import time
from collections.abc import Sequence

UNKNOWN = "—"
BARS = "▁▂▃▄▅▆▇█"


def micrometres(length: float) -> str:
    """Write a length [m] in µm with three digits that count, `0.243 µm`."""
    if math.isnan(length):
        return UNKNOWN
    return f"{_three_digits(length * 1e6)} µm"


def milliseconds(duration: float) -> str:
    """Write a duration [s] in ms, `1.25 ms`."""
    return UNKNOWN if math.isnan(duration) else f"{_three_digits(duration * 1e3)} ms"


def _three_digits(value: float) -> str:
    size = abs(value)
    if size >= 99.95:
        return f"{value:.0f}"
    if size >= 9.995:
        return f"{value:.1f}"
    return f"{value:.2f}" if size >= 0.9995 else f"{value:.3f}"


def clock_time(seconds: float) -> str:
    """Write a duration [s] as `1:02:03`, with days in front where there are some."""
    whole = max(0, int(seconds))
    days, rest = divmod(whole, 86_400)
    text = f"{rest // 3600}:{rest % 3600 // 60:02d}:{rest % 60:02d}"
    return f"{days} d {text}" if days else text


def time_of_day(wall: float) -> str:
    """Write a wall-clock time [s since the epoch] as local `12:34:56`."""
    return time.strftime("%H:%M:%S", time.localtime(wall))


def trend_line(values: Sequence[float], width: int) -> str:
    """Draw positive values as bars on a logarithmic scale; a gap where one is unknown.

    Args:
        values: What to draw, oldest first; NaN where unknown.
        width: Characters at most; the newest values are drawn.
    """
    shown = list(values)[-max(width, 0) :] if width > 0 else []
    known = [math.log(value) for value in shown if value > 0.0]
    if not known:
        return " " * len(shown)
    low, high = min(known), max(known)
    # Less than a factor of 2 from lowest to highest is noise: draw it flat, not as mountains.
    scale = (len(BARS) - 1) / max(high - low, math.log(2.0))
    return "".join(
        BARS[round((math.log(value) - low) * scale)] if value > 0.0 else " " for value in shown
    )
