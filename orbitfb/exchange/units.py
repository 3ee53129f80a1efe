"""Units that files from elsewhere come in, and their size in SI. None is ever assumed."""

from collections.abc import Mapping

from orbitfb.core import units
from orbitfb.core.errors import ExchangeError
from orbitfb.core.units import plain

ORBIT, CURRENT = units.ORBIT, units.CURRENT
"""Of orbits, in m; of setpoints and readbacks, in A."""

TIME: Mapping[str, float] = {**units.TIME, "datenum": 86_400.0}
"""Of time, in s; `datenum` is MATLAB's count of days since the year 0."""

PER_CURRENT, PER_KICK = units.PER_CURRENT, units.PER_KICK
"""Of responses, in m/A and in m/rad; the calibration of the correctors makes m/A of the latter."""

RESPONSE: Mapping[str, float] = {**PER_CURRENT, **PER_KICK}


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
