"""Times as text: ISO 8601 and what archivers and spreadsheets make of it, in whole nanoseconds."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector

_MONTHS: list[str] = [
    "jan",
    "feb",
    "mar",
    "apr",
    "may",
    "jun",
    "jul",
    "aug",
    "sep",
    "oct",
    "nov",
    "dec",
]
_OF_DAY = r"(?:[T ]\s*(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,18}))?)?)?"
_ZONE = r"\s*(Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?)?(?:\[[\w/+-]+\])?"
_TIME = re.compile(rf"(\d{{4}})([-/])(\d{{1,2}})\2(\d{{1,2}}){_OF_DAY}{_ZONE}", re.IGNORECASE)
_NAMED = re.compile(rf"(\d{{1,2}})[- ]([A-Za-z]{{3}})[- ](\d{{4}}){_OF_DAY}{_ZONE}", re.IGNORECASE)
_AMBIGUOUS = re.compile(r"\d{1,2}[/.]\d{1,2}[/.]\d{2,4}\b")
_FORM = "write 2024-10-27T02:59:54.100+01:00, year first"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NANO = 1_000_000_000


def is_time(text: str) -> bool:
    """Tell whether a text is meant as a time, readable or not."""
    return any(form.match(text) for form in (_TIME, _NAMED, _AMBIGUOUS))


def zone_of(name: str) -> tzinfo:
    """Find a time zone.

    Args:
        name: `UTC`, `+02:00`, or a name of the IANA table such as `Europe/Berlin`.

    Raises:
        ExchangeError: There is none of this name.
    """
    if found := re.fullmatch(_ZONE, name.strip(), re.IGNORECASE):
        if found[1]:
            return _offset(found[1])
    else:
        try:
            return ZoneInfo(name.strip())
        except (ZoneInfoNotFoundError, ValueError, OSError):
            pass
    raise ExchangeError(
        f"--time-zone {name}: no time zone; give UTC, an offset such as +02:00, or a name such as "
        "Europe/Berlin"
    )


def seconds_of(texts: Sequence[str], zone: str | None, what: str) -> Vector:
    """Read times.

    Args:
        texts: One a row, in the order in which they were.
        zone: That of times that do not say theirs; None: not known.
        what: What the times are, for messages.

    Returns:
        Since 1970, shape (k,) [s].

    Raises:
        ExchangeError: One is no time, or nobody says the zone.
    """
    its_zone = zone_of(zone) if zone else None
    moments: list[datetime] = []
    nanos = np.empty(len(texts), np.int64)
    for row, text in enumerate(texts):
        moment, nanos[row] = _read(text, what, row)
        if moment.tzinfo is None:
            if its_zone is None:
                raise ExchangeError(
                    f"{what}, row {row + 1}: {text!r} does not say its time zone; give --time-zone "
                    "UTC, +02:00 or Europe/Berlin, or write the offset"
                )
            moment = moment.replace(tzinfo=its_zone)
        moments.append(moment)
    return (_in_order(moments, what) + nanos) / _NANO


def _in_order(moments: Sequence[datetime], what: str) -> NDArray[np.int64]:
    """Give nanoseconds since 1970; an hour that a clock shows twice is told apart by the order."""
    first = np.array([_nanoseconds(moment) for moment in moments], np.int64)
    again = np.array([_nanoseconds(moment.replace(fold=1)) for moment in moments], np.int64)
    stamps = first.copy()
    for row in np.flatnonzero(again > first):
        if row and first[row] < stamps[row - 1] <= again[row]:
            stamps[row] = again[row]
    if len(first) and again[0] > first[0] and not (stamps != first).any():
        raise ExchangeError(
            f"{what}: {moments[0]:%Y-%m-%d %H:%M:%S} was there twice, as the clock was set back in "
            f"{moments[0].tzinfo}; write the offset of every time, or give --time-zone as an offset"
        )
    return stamps


def _nanoseconds(moment: datetime) -> int:
    since = moment - _EPOCH
    return (since.days * 86_400 + since.seconds) * _NANO


def _read(text: str, what: str, row: int) -> tuple[datetime, int]:
    """Read one time: whole seconds, and nanoseconds."""
    if found := _TIME.fullmatch(text.strip()):
        year, month, day = int(found[1]), int(found[3]), int(found[4])
        rest = found.groups()[4:]
    elif (found := _NAMED.fullmatch(text.strip())) and found[2].lower() in _MONTHS:
        day, month, year = int(found[1]), _MONTHS.index(found[2].lower()) + 1, int(found[3])
        rest = found.groups()[3:]
    else:
        day_or_month = _AMBIGUOUS.match(text)
        reason = "may have the day or the month first" if day_or_month else "is no time"
        raise ExchangeError(f"{what}, row {row + 1}: {text[:40]!r} {reason}; {_FORM}")
    hour, minute, second, fraction, zone = rest
    try:
        moment = datetime(year, month, day, int(hour or 0), int(minute or 0), int(second or 0))
    except ValueError as error:
        raise ExchangeError(f"{what}, row {row + 1}: {text!r}: {error}; {_FORM}") from error
    nanos = int((fraction or "0")[:9].ljust(9, "0"))
    return moment.replace(tzinfo=_offset(zone)) if zone else moment, nanos


def _offset(text: str) -> tzinfo:
    if not text.startswith(("+", "-")):
        return UTC
    hours, minutes = int(text[1:3]), int(text[3:].lstrip(":") or 0)
    shift = timedelta(hours=hours, minutes=minutes)
    return timezone(-shift if text.startswith("-") else shift)
