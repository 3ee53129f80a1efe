"""Quantities as people write them: `0.1s`, `50ms`, `2%`, `20um`, `5mrad`; SI inside."""

import re
from math import isfinite, pi

_PREFIXES = {
    "": 1.0,
    "p": 1e-12,
    "n": 1e-9,
    "u": 1e-6,
    "µ": 1e-6,
    "μ": 1e-6,
    "m": 1e-3,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}
_OTHERS = {
    "1": {"%": 1e-2, "‰": 1e-3, "ppm": 1e-6},
    "s": {"min": 60.0, "h": 3600.0},
    "rad": {"deg": pi / 180.0, "°": pi / 180.0},
}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
_FACTOR = re.compile(r"(.*?)(?:\^?([23])|([²³]))?")
_POWERS = {"²": 2, "³": 3}


def parse_quantity(text: str, unit: str) -> float:
    """Read a number with or without a unit.

    Args:
        text: `0.1`, `100ms`, `2 %`.
        unit: SI unit that it is to be in, `1` for a ratio; a number without a unit is in it.

    Raises:
        ValueError: It is no finite number, or its unit is of something else.
    """
    found = _QUANTITY.fullmatch(text)
    if not found:
        raise ValueError(f"{text!r} is no number [{unit}]")
    value = float(found[1])
    if not isfinite(value):
        raise ValueError(f"{text!r} is not finite")
    return value * unit_factor(found[2], unit)


def unit_factor(written: str, unit: str) -> float:
    """Tell how much of an SI unit one of a written unit is.

    Args:
        written: `ms`, `mm/A`, `%`, or nothing.
        unit: SI unit, `1` for a ratio.

    Raises:
        ValueError: They are not of the same kind.
    """
    if written in ("", unit):
        return 1.0
    parts, wanted = written.split("/"), unit.split("/")
    if len(parts) == len(wanted):
        factors = [_simple(part, base) for part, base in zip(parts, wanted, strict=True)]
        if None not in factors:
            scale = 1.0
            for index, factor in enumerate(factors):
                if factor is not None:
                    scale *= factor if index == 0 else 1.0 / factor
            return scale
    raise ValueError(f"{written!r} is no unit of what is measured in {_say(unit)}")


def _simple(written: str, unit: str) -> float | None:
    """Factor of a unit without a slash, a prefix and a power allowed; None: another kind."""
    other = _OTHERS.get(unit, {}).get(written)
    if other is not None:
        return other
    given, wanted = _FACTOR.fullmatch(written), _FACTOR.fullmatch(unit)
    if unit == "1" or not given or not wanted or _power(given) != _power(wanted):
        return 1.0 if written == unit else None
    prefix = given[1].removesuffix(wanted[1]) if given[1].endswith(wanted[1]) else "?"
    factor = _PREFIXES.get(prefix)
    return None if factor is None else factor ** _power(given)


def _power(found: re.Match[str]) -> int:
    return int(found[2] or 0) or _POWERS.get(found[3] or "", 1)


def _say(unit: str) -> str:
    if unit == "1":
        return "ratios; write 0.02 or 2%"
    return f"{unit}; write {unit}, or with a prefix m{unit}, u{unit}"
