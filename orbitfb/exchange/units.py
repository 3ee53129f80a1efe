"""Units that files from elsewhere come in, and their size in SI. None is ever assumed."""

from collections.abc import Mapping

from orbitfb.core.errors import ExchangeError

_ORBIT = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
_CURRENT = {"A": 1.0, "mA": 1e-3}
_KICK = {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6}

ORBIT: Mapping[str, float] = _ORBIT
"""Of orbits, in m."""

CURRENT: Mapping[str, float] = _CURRENT
"""Of setpoints and readbacks, in A."""

TIME: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "datenum": 86_400.0}
"""Of time, in s; `datenum` is MATLAB's count of days since the year 0."""

PER_CURRENT: Mapping[str, float] = {
    f"{orbit}/{current}": size / unit
    for orbit, size in _ORBIT.items()
    for current, unit in _CURRENT.items()
}
"""Of responses, in m/A."""

PER_KICK: Mapping[str, float] = {
    f"{orbit}/{kick}": size / unit for orbit, size in _ORBIT.items() for kick, unit in _KICK.items()
}
"""Of responses to kicks, in m/rad; the calibration of the correctors makes m/A of them."""

RESPONSE: Mapping[str, float] = {**PER_CURRENT, **PER_KICK}


def plain(unit: str) -> str:
    """Write a unit as the tables here do: `µ` as u, no blanks, A and not amp."""
    text = unit.strip().replace("µ", "u").replace("μ", "u").replace(" ", "")
    return {"micron": "um", "ampere": "A", "amp": "A", "Amp": "A", "a": "A"}.get(text, text)


def factor(
    stated: str | None, written: str, known: Mapping[str, float], what: str, option: str
) -> tuple[str, float]:
    """Settle a unit by what the caller and the file say.

    Args:
        stated: By the caller, or None.
        written: In the file, or empty.
        known: The units that can be.
        what: What has the unit, for messages.
        option: The option that states it.

    Returns:
        The unit, and what the numbers are to be multiplied with to be in SI.

    Raises:
        ExchangeError: Nobody says, they disagree, or the unit is not known.
    """
    given, inside = plain(stated or ""), plain(written)
    if given and inside and given != inside:
        raise ExchangeError(
            f"{what}: the file says {written!r}, {option} says {stated!r}; correct the one that is "
            "wrong"
        )
    unit = given or inside
    if not unit:
        raise ExchangeError(
            f"{what}: neither the file nor {option} says the unit, and it is not guessed; give "
            f"{option} {', '.join(known)}"
        )
    if unit not in known:
        raise ExchangeError(
            f"{what}: the unit {unit!r} is not known; use one of {', '.join(known)}"
        )
    return unit, known[unit]
