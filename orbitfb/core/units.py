"""Units as people write them: `Amps`, `mm/Ampere`, `µm`, `50ms`, `2 %`; SI inside.

There is one table for every reader: files of others, records, effects, the EGU of PVs.
"""

import re
from collections.abc import Iterable, Mapping
from math import isfinite, pi

_PREFIXES = {
    "": 1.0,
    "p": 1e-12,
    "n": 1e-9,
    "u": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
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

_NAMES = {
    "m": ("meter", "metre"),
    "A": ("amp", "ampere", "ampère"),
    "s": ("sec", "second"),
    "rad": ("radian",),
    "Hz": ("hertz",),
}
_LONG_PREFIXES = {
    "": "",
    "nano": "n",
    "micro": "u",
    "milli": "m",
    "centi": "c",
    "kilo": "k",
    "mega": "M",
    "giga": "G",
}
_WORDS = {
    prefix + name + plural: short + unit
    for unit, names in _NAMES.items()
    for name in names
    for prefix, short in _LONG_PREFIXES.items()
    for plural in ("", "s")
} | {"micron": "um", "microns": "um"}
_SHORT = {
    (prefix + unit).lower(): prefix + unit
    for unit, prefixes in (("m", "ncum"), ("A", "kum"), ("s", "num"), ("rad", "um"), ("Hz", "kMG"))
    for prefix in ("", *prefixes)
}
"""Units by their letters in lower case: a record's `MM` and `MA` are no megametre or megaampere."""

_REMARK = re.compile(r"(?<=\S)\s*[(\[,;].*$", re.DOTALL)
_INVERSE = re.compile(r"[ ·*.]+([^\W\d]+)(?:\^?[-−]1|⁻¹)$")
_PER = re.compile(r"\s*(?:/|\bper\b)\s*", re.IGNORECASE)


def plain(written: str) -> str:
    """Write a unit in one way: `um` for µm or microns, `mm/A` for mm per Ampere.

    Args:
        written: As a person, a file or a record has it, brackets around it allowed, and a remark
            behind it: `A (change that was asked for)`.

    Returns:
        The unit; what is not known stays as it is, without blanks at its ends.
    """
    text = written.strip()
    if text[:1] + text[-1:] in ("[]", "()"):
        text = text[1:-1].strip()
    text = _REMARK.sub("", text)
    text = _INVERSE.sub(r"/\1", text.replace("µ", "u").replace("μ", "u"))
    return "/".join(_plain(part.strip()) for part in _PER.split(text))


def _plain(part: str) -> str:
    low = part.lower()
    if low in _WORDS:
        return _WORDS[low]
    return part if part in _SHORT.values() else _SHORT.get(low, part)


def sizes(units: Iterable[str], base: str) -> Mapping[str, float]:
    """Give the size of some units, each in its SI unit.

    Args:
        units: As `plain` writes them.
        base: The SI unit.
    """
    return {unit: unit_factor(unit, base) for unit in units}


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
        written: `ms`, `mm/A`, `microns`, `%`, or nothing.
        unit: SI unit, `1` for a ratio.

    Raises:
        ValueError: They are not of the same kind.
    """
    for text in (written.replace("µ", "u").replace("μ", "u"), plain(written)):
        if text in ("", unit):
            return 1.0
        parts, wanted = text.split("/"), unit.split("/")
        if len(parts) != len(wanted):
            continue
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


ORBIT = sizes(("m", "mm", "um", "nm"), "m")
"""Of orbits, in m."""

CURRENT = sizes(("A", "mA"), "A")
"""Of setpoints, readbacks and the stored current, in A."""

TIME = sizes(("s", "ms", "us", "ns"), "s")
"""Of time, in s."""

KICK = sizes(("rad", "mrad", "urad"), "rad")
"""Of kicks, in rad."""

PER_CURRENT = sizes((f"{orbit}/{current}" for orbit in ORBIT for current in CURRENT), "m/A")
"""Of responses, in m/A."""

PER_KICK = sizes((f"{orbit}/{kick}" for orbit in ORBIT for kick in KICK), "m/rad")
"""Of responses to kicks, in m/rad; the calibration of the correctors makes m/A of them."""
