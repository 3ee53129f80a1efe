"""What the text `meta` of a record says, and units."""

import difflib
import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfb.core.units import CURRENT, ORBIT, PER_CURRENT, TIME, plain, sizes
from orbitfb.records.finding import Finding
from orbitfb.records.gaps import is_gap
from orbitfb.records.reading.raw import NUMBERS, Raw, canonical

_SIZES = {
    "orbit": ORBIT,
    "action": CURRENT,
    "model_R": PER_CURRENT,
    "t": TIME,
    "current": CURRENT,
    "gap": sizes(("m", "cm", "mm", "um"), "m"),
    "rf": sizes(("Hz", "kHz", "MHz"), "Hz"),
}
_USUAL = {"orbit": "mm", "action": "A", "model_R": "mm/A", "t": "s"}
_ALSO = {"next_orbit": "orbit", "reference": "orbit", "setpoint": "action", "dither": "action"}
_ALSO["readback"] = "action"
_UNUSUAL = {unit for kind in _USUAL for unit in _SIZES[kind]} - set(_USUAL.values())
_ALIKE = 0.8
_KEYS = ("dt_s", "planes", "plane", "bpm_planes", "corr_planes", "units")


@dataclass(frozen=True, slots=True)
class Meta:
    """What a record says of itself.

    Args:
        period: From one orbit to the next [s]; None if it does not say.
        planes: `x`, `y`, `xy`, or empty.
        bpm_planes: Plane of every BPM, or empty.
        corr_planes: Plane of every corrector, or empty.
        units: Unit of arrays, as written.
    """

    period: float | None
    planes: str
    bpm_planes: tuple[str, ...]
    corr_planes: tuple[str, ...]
    units: dict[str, str]

    def factor(self, raw: Raw, name: str) -> float:
        """Give what an array is to be multiplied with to be in SI.

        Raises:
            RecordError: The unit is not known.
        """
        kind = "gap" if is_gap(name) else _ALSO.get(name, name)
        unit = self.units.get(name, self.units.get(kind, _USUAL.get(kind)))
        if unit is None:
            return _guessed(raw, name)
        size = _SIZES[kind].get(unit)
        if size is None:
            raise raw.wrong(
                name if plain(raw.units.get(name, "")) == unit else "meta",
                f"says that {name} is in {unit!r}",
                f"use one of {', '.join(_SIZES[kind])}, or leave units.{name} out",
            )
        return size


def unread_keys(raw: Raw) -> list[Finding]:
    """Tell keys of `meta` that are not read, but are nearly one that is: `unit` for `units`.

    Args:
        raw: The arrays; its `meta` has been read.
    """
    found: list[Finding] = []
    for key in _content(raw):
        short = len(key) > 1 and [known for known in _KEYS if known.startswith(key.lower())]
        near = short or difflib.get_close_matches(key.lower(), _KEYS, 1, _ALIKE)
        if near and key not in _KEYS:
            text = f"meta: {key!r:.40} is not read; did you mean {near[0]!r}?"
            found.append(Finding("unread-meta", "warning", (), None, text))
    return found


def _content(raw: Raw) -> dict[str, Any]:
    text = raw.texts.get("meta", ("",))[0].strip()
    try:
        content: Any = json.loads(text) if text else {}
    except (ValueError, RecursionError) as error:
        raise raw.wrong(
            "meta", f"is no JSON ({error or 'too deep'})", "correct it, or leave it out"
        ) from error
    if not isinstance(content, dict):
        raise raw.wrong("meta", f"is a {type(content).__name__}", "write a JSON object {…}")
    return content


def read_meta(raw: Raw) -> Meta:
    """Read the text `meta`; a record without one says nothing.

    Raises:
        RecordError: It is no JSON object, or a key has a wrong value.
    """
    content = _content(raw)
    return Meta(
        period=_period(raw, content),
        planes=_planes(raw, content),
        bpm_planes=_each_plane(raw, content, "bpm_planes"),
        corr_planes=_each_plane(raw, content, "corr_planes"),
        units=_units(raw, content.get("units")),
    )


def _period(raw: Raw, content: dict[str, Any]) -> float | None:
    period = content.get("dt_s")
    if period is None:
        return None
    number = isinstance(period, int | float) and not isinstance(period, bool)
    if not number or not 0 < period < 1e6:  # an integer may be too long for a float
        raise raw.wrong("meta", f"has dt_s = {period!r:.40}", "give the period in seconds, above 0")
    return float(period)


def _planes(raw: Raw, content: dict[str, Any]) -> str:
    planes = content.get("planes", content.get("plane", ""))
    if isinstance(planes, list) and all(isinstance(plane, str) for plane in planes):
        planes = "".join(dict.fromkeys(planes))
    known = {"": "", "x": "x", "y": "y", "h": "x", "v": "y", "xy": "xy", "hv": "xy"}
    if not isinstance(planes, str) or planes.lower() not in known:
        raise raw.wrong("meta", f"has planes = {planes!r}", 'give "x", "y" or "xy"')
    return known[planes.lower()]


def _each_plane(raw: Raw, content: dict[str, Any], key: str) -> tuple[str, ...]:
    planes = content.get(key, "")
    if not isinstance(planes, str | list) or any(plane not in ("x", "y") for plane in planes):
        raise raw.wrong("meta", f"has {key} = {planes!r}", "give an 'x' or a 'y' for every column")
    return tuple(planes)


def _units(raw: Raw, units: Any) -> dict[str, str]:
    """Take units by array, from `meta` and from beside the arrays."""
    advice = 'write "units": {"orbit": "um"}, one text for every array in another unit than usual'
    if isinstance(units, str) and not _UNUSUAL & set(map(plain, re.findall(r"[\w/]+", units))):
        units = None  # for people
    if not isinstance(units, dict | None):
        raise raw.wrong("meta", f"has units = {units!r:.40}, which says not of what", advice)
    stated: dict[str, str] = {}
    for key, unit in (units or {}).items():
        name = canonical(key)
        near = difflib.get_close_matches(name, NUMBERS, 1, _ALIKE)
        if near and name not in raw.numbers and name not in NUMBERS:
            raise raw.wrong(
                "meta", f"gives a unit of {key!r}, which is no array", f"do you mean {near[0]}?"
            )
        if not isinstance(unit, str | None):
            raise raw.wrong("meta", f"has units.{key} = {unit!r:.40}", advice)
        if unit:
            stated[name] = plain(unit)
    beside = {name: plain(unit) for name, unit in raw.units.items()}
    for name, unit in beside.items():
        said = stated.get(name, stated.get(_ALSO.get(name, name), unit))
        if said != unit:
            raise raw.wrong(
                name, f"is in {unit!r} by its attribute, in {said!r} by meta", "correct one of them"
            )
    stated = beside | stated
    if "orbit" not in stated and stated.get("next_orbit", _USUAL["orbit"]) != _USUAL["orbit"]:
        raise raw.wrong(
            "orbit",
            f"has no unit, but next_orbit is said to be in {stated['next_orbit']!r}",
            "state the unit of both: units.orbit in meta holds for both",
        )
    return stated


def _guessed(raw: Raw, name: str) -> float:
    """Tell units by size: no stored current is above 5 A, no gap outside 0.5 mm to 500 mm."""
    values = raw.numbers[name]
    if is_gap(name):
        widest = float(np.max(np.abs(values), initial=0.0))
        return 1.0 if widest < 0.5 else 1e-3 if widest < 500.0 else 1e-6
    there = values[np.isfinite(values)]
    typical = abs(float(there[0])) if len(there) else 0.0
    if name == "current":
        return 1e-3 if typical > 5.0 else 1.0
    return 1e6 if 10.0 < typical < 1e4 else 1e3 if 1e5 < typical < 1e7 else 1.0
