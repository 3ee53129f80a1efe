"""Numbers for people: three digits, with a prefix that keeps them between 1 and 1000."""

from collections.abc import Sequence

from orbitfb.diagnose.result.parts import ParameterValue

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))
_PREFIXED = ("m", "A", "rad", "s", "V", "T", "eV")
"""Units that take a prefix; others, such as 1/m, are written without one."""


def quantity(value: float | None, unit: str = "1") -> str:
    """Write a number with its unit: `2.3 mA` of 0.0023 A."""
    return interval(value, None, None, unit)


def interval(value: float | None, low: float | None, high: float | None, unit: str = "1") -> str:
    """Write a number with its interval and unit, all with one prefix."""
    if value is None:
        return "not resolved"
    ends = [end for end in (low, high) if end is not None]
    scale, prefix = _prefix([value, *ends], unit)
    text = _digits(value / scale)
    if low is not None and high is not None and high > low:
        text += f" [{_digits(low / scale)}, {_digits(high / scale)}]"
    told = f"{prefix}{unit}" if unit not in ("", "1") else ""
    return f"{text} {told}".rstrip()


def parameter(value: ParameterValue) -> str:
    """Write a parameter with its interval; a choice in the words of what it stands for."""
    return value.meaning or interval(value.value, value.low, value.high, value.unit)


def percent(share: float | None, low: float | None = None, high: float | None = None) -> str:
    """Write a share in per cent, with its interval."""
    if share is None:
        return "not resolved"
    ends = "" if low is None or high is None else f" [{100 * low:.0f}, {100 * high:.0f}]"
    return f"{_whole(share)} %{ends}"


def chance(probability: float | None) -> str:
    """Write a probability, never as certain: no record can prove that."""
    if probability is None:
        return "not resolved"
    return "above 0.99" if probability > 0.99 else f"{probability:.2g}"


def _whole(share: float) -> str:
    """Per cent, never rounded to all of it where something is left."""
    return "99" if 0.99 < share < 0.999 else f"{100 * share:.0f}"


def _prefix(values: Sequence[float], unit: str) -> tuple[float, str]:
    first = unit.split("/")[0].split(" ")[0]
    largest = max(abs(value) for value in values)
    if first not in _PREFIXED:
        return 1.0, ""
    if largest == 0.0:
        return (1e-6, "µ") if first == "m" else (1.0, "")
    for scale, prefix in _PREFIXES:
        if largest >= 0.9995 * scale:
            return scale, prefix
    return _PREFIXES[-1]


def _digits(value: float) -> str:
    """Three digits, without an exponent where that is readable, and no zero with a sign."""
    value += 0.0
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e6 else f"{value:.3g}"
