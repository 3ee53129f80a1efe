"""What viewers are sent: asked and encoded once, newest first, bounded."""

import asyncio
import json
from itertools import pairwise
from pathlib import Path

from page_parts import Service, answer, filled, page_job

from orbitfb.core.errors import ControlError
from orbitfb.page.feed import TREND_POINTS, Feed


def picture(feed: Feed) -> dict:
    return json.loads(asyncio.run(feed.after(0))[1])


def test_ten_viewers_ask_the_service_no_more_than_one(tmp_path: Path):
    service = Service()

    async def look() -> set[int]:
        feed = Feed(page_job(tmp_path), service)
        waiting = [asyncio.create_task(feed.after(0)) for _ in range(10)]
        await asyncio.sleep(0)
        await feed.once()
        texts = [text for _, text in await asyncio.gather(*waiting)]
        feed.close()
        return {id(text) for text in texts}

    assert len(asyncio.run(look())) == 1 and service.asked == 1


def test_who_is_slow_gets_the_newest_only(tmp_path: Path):
    service = Service()
    feed = filled(page_job(tmp_path), service)
    for time in (101.0, 102.0, 103.0):
        service.answer = answer(time)
        asyncio.run(feed.once())
    number, text = asyncio.run(feed.after(1))
    feed.close()
    assert number == 4 and json.loads(text)["time"] == 103.0


def test_a_service_that_does_not_answer_is_told(tmp_path: Path):
    service = Service()
    service.problem = ControlError("nobody there")
    feed = filled(page_job(tmp_path), service)
    feed.close()
    told = picture(feed)
    assert (told["kind"], told["problem"]) == ("problem", "nobody there")


def test_the_trend_has_a_point_a_second_and_bounds(tmp_path: Path):
    service = Service()
    feed = Feed(page_job(tmp_path), service)

    async def tell() -> None:
        for step in range(2 * TREND_POINTS + 100):
            service.answer = answer(100.0 + step / 2, step)
            await feed.once()

    asyncio.run(tell())
    trend = json.loads(feed.hello(""))["trend"]
    assert len(trend) == TREND_POINTS
    assert {b[0] - a[0] for a, b in pairwise(trend)} == {1.0}
    service.answer = answer(50.0) | {"alive": False}  # the clock was set back; nothing is known
    asyncio.run(feed.once())
    feed.close()
    assert json.loads(feed.hello(""))["trend"] == [[50.0, 0.2, None]]


def test_a_point_of_the_trend_is_the_largest_of_late_not_the_last(tmp_path: Path):
    service = Service()
    service.answer = answer() | {"rms_um": {"x": 1.0}, "rms_peak_um": {"x": 80.0}}
    feed = filled(page_job(tmp_path), service)
    feed.close()
    assert json.loads(feed.hello(""))["trend"] == [[100.0, 0.2, 80.0]]


def test_it_asks_seldom_until_somebody_looks(tmp_path: Path):
    service = Service()

    async def story() -> list[int]:
        feed = Feed(page_job(tmp_path, viewers=1), service)
        asking = asyncio.create_task(feed.keep_asking())
        counts = []
        number, _ = await feed.after(0)
        await asyncio.sleep(0.3)
        counts.append(service.asked)
        assert feed.join() and not feed.join()
        for _ in range(3):
            number, _ = await feed.after(number)
        counts.append(service.asked)
        asking.cancel()
        feed.close()
        return counts

    alone, looked_at = asyncio.run(story())
    assert alone == 1 and looked_at >= 4
