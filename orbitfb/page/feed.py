"""What every viewer is sent: asked of the service and encoded once, however many there are."""

import asyncio
import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from orbitfb.core.errors import ControlError
from orbitfb.page.job import PageJob
from orbitfb.page.reports import find_reports

PERIOD = 0.2
"""Time between two pictures while somebody looks [s]."""
IDLE_PERIOD = 1.0
"""The same while nobody does: for the trend [s]."""
ASK_TIMEOUT = 2.0
"""How long the service may take to say how it is [s]."""
TREND_PERIOD, TREND_POINTS = 1.0, 900
"""Time between two points of the trend [s], and how many there are: a quarter of an hour."""
REPORTS_PERIOD = 5.0
"""How often to look for a new report [s]."""

Ask = Callable[[dict[str, Any], float], Mapping[str, Any]]


class Feed:
    """Keeps the newest picture; whoever is slow misses those in between.

    Args:
        job: What to show.
        ask: Asks the service: request and time limit [s] in, answer out.
    """

    def __init__(self, job: PageJob, ask: Ask) -> None:
        self._job, self._ask = job, ask
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="page")
        self._changed, self._joined = asyncio.Event(), asyncio.Event()
        self._trend: deque[list[Any]] = deque(maxlen=TREND_POINTS)
        self._report: dict[str, Any] | None = None
        self._looked = -math.inf
        self._number, self._picture = 0, _dump({"kind": "problem", "problem": "starting"})
        self.viewers = 0

    def join(self) -> bool:
        """Count a viewer in; False: there are too many already."""
        if self.viewers >= self._job.web.viewers:
            return False
        self.viewers += 1
        self._joined.set()
        return True

    def leave(self) -> None:
        """Count a viewer out."""
        self.viewers -= 1

    def hello(self, assets: str) -> str:
        """Give what a viewer is sent first: the ring and the trend so far.

        Args:
            assets: Names the files of the page; one that has others loads itself again.
        """
        layout = self._job.layout.model_dump(mode="json")
        return _dump(
            {
                "kind": "hello",
                "assets": assets,
                "layout": layout,
                "trend": list(self._trend),
                "trend_period": TREND_PERIOD,
            }
        )

    async def after(self, number: int) -> tuple[int, str]:
        """Wait for a picture newer than one, and give the newest with its number.

        Args:
            number: Of the one that the viewer has; 0: none.
        """
        while self._number == number:
            await self._changed.wait()
        return self._number, self._picture

    async def keep_asking(self) -> None:
        """Ask again and again, more often while somebody looks."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            await self.once()
            period = PERIOD if self.viewers else IDLE_PERIOD
            due = max(due + period, loop.time())
            self._joined.clear()
            while (left := due - loop.time()) > 0:
                try:
                    await asyncio.wait_for(self._joined.wait(), left)
                except TimeoutError:
                    break
                self._joined.clear()
                due = min(due, loop.time() + PERIOD)  # somebody has come to look

    async def once(self) -> None:
        """Ask the service how it is and have a picture ready."""
        try:
            answer = await self._in_thread(self._ask, {"command": "page"}, ASK_TIMEOUT)
        except ControlError as error:
            self._publish({"kind": "problem", "problem": str(error), "time": time.time()})
            return
        await self._look_for_reports()
        self._note(answer)
        self._publish({"kind": "live", **answer, "report": self._report})

    def close(self) -> None:
        """Wait for nothing any more."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _publish(self, picture: Mapping[str, Any]) -> None:
        self._picture = _dump(picture)
        self._number += 1
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _note(self, answer: Mapping[str, Any]) -> None:
        now = float(answer["time"])
        since = now - self._trend[-1][0] if self._trend else math.inf
        if 0 <= since < 0.95 * TREND_PERIOD:
            return
        if since < 0:  # the clock was set back
            self._trend.clear()
        # not that of the last orbit: an excursion between two points would be missed
        rms = answer["rms_peak_um"] if answer["alive"] else {}
        planes = [rms.get(plane) for plane in self._job.layout.planes]
        self._trend.append([round(now, 2), answer["floor_um"], *planes])

    async def _look_for_reports(self) -> None:
        now = time.monotonic()
        if now - self._looked >= REPORTS_PERIOD:
            self._looked = now
            self._report = await self._in_thread(self._newest)

    def _newest(self) -> dict[str, Any] | None:
        reports = find_reports(self._job.data_directory)
        if not reports:
            return None
        newest = reports[0]
        return {"name": newest.name, "time": newest.time, "headline": newest.headline()}

    async def _in_thread(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._pool, function, *arguments)


def _dump(message: Mapping[str, Any]) -> str:
    return json.dumps(message, allow_nan=False, separators=(",", ":"))
