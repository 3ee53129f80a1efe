"""Times as text are read to the nanosecond, or refused with what to write."""

from datetime import UTC, datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from orbitfb.core.errors import ExchangeError
from orbitfb.exchange.times import is_time, seconds_of

HALF_PAST = datetime(2024, 10, 27, 0, 58, 20, 100000, timezone(timedelta(0))).timestamp()


@pytest.mark.parametrize(
    "text",
    [
        "2024-10-27T00:58:20.100Z",
        "2024-10-27T00:58:20.1+00:00",
        "2024-10-27 02:58:20,100+0200",
        "2024-10-26T20:58:20.100000000-04",
        "2024/10/27 00:58:20.100 UTC",
        "27-Oct-2024 00:58:20.100Z",
        "2024-10-27T02:58:20.1+02:00[Europe/Berlin]",
    ],
)
def test_forms_with_a_zone(text):
    assert is_time(text)
    assert seconds_of([text], None, "a.csv: time")[0] == pytest.approx(HALF_PAST, abs=1e-6)


@pytest.mark.parametrize("zone", ["Europe/Berlin", "+02:00", "+02"])
def test_a_zone_for_times_that_have_none(zone):
    found = seconds_of(["2024-10-27 01:58:20.1"], zone, "a.csv: time")[0]
    assert found == pytest.approx(HALF_PAST - 3600.0, abs=1e-6)


def test_times_without_a_zone_are_not_guessed():
    with pytest.raises(ExchangeError, match=r"a.csv: time, row 2: .* give --time-zone UTC"):
        seconds_of(["2024-10-27T01:58:20Z", "2024-10-27 01:58:21"], None, "a.csv: time")


@pytest.mark.parametrize("zone", ["Berlin", "", "+2", "Europe/../etc"])
def test_a_zone_that_there_is_not(zone):
    if zone:
        with pytest.raises(ExchangeError, match=r"--time-zone .*: no time zone; give UTC"):
            seconds_of(["2024-10-27 01:58:20"], zone, "time")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("10/27/2024 00:58:20", "day or the month first; write 2024"),
        ("27.10.2024 00:58", "day or the month first"),
        ("2024-13-27 00:58:20Z", "month must be in"),
        ("2024-10-27T25:00:00Z", "hour must be in"),
        ("2024-10-27 noon", "is no time; write 2024"),
    ],
)
def test_what_is_no_time_is_named_with_its_row(text, words):
    with pytest.raises(ExchangeError, match=words):
        seconds_of([text], "UTC", "time")


def test_the_hour_that_is_there_twice_is_told_apart_by_the_order():
    zone = ZoneInfo("Europe/Berlin")
    begin = datetime(2024, 10, 26, 23, 30, tzinfo=UTC)
    moments = [begin + timedelta(minutes=10 * k) for k in range(18)]
    texts = [f"{moment.astimezone(zone):%Y-%m-%d %H:%M:%S}" for moment in moments]
    found = seconds_of(texts, "Europe/Berlin", "time")
    np.testing.assert_array_equal(found, [moment.timestamp() for moment in moments])
    with pytest.raises(ExchangeError, match=r"was there twice.*write the offset of every time"):
        seconds_of(["2024-10-27 02:30:00", "2024-10-27 02:40:00"], "Europe/Berlin", "time")


def test_ten_kilohertz_stamps_stay_apart():
    texts = [f"2024-10-27T00:58:20.{k:09d}Z" for k in range(0, 10**6, 10**5)]
    steps = np.diff(seconds_of(texts, None, "time"))
    np.testing.assert_allclose(steps, 1e-4, atol=3e-7)
