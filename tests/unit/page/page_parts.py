"""A job, an answer of the service and a feed for the tests of the page."""

import asyncio
from pathlib import Path
from typing import Any

from orbitfb.page.feed import Feed
from orbitfb.page.job import PageJob, PageLayout
from orbitfb.page.settings import WebSettings


def page_job(directory: Path, **web: Any) -> PageJob:
    layout = PageLayout(
        planes="x",
        bpms=("A", "B", "C"),
        bpm_s=(1.0, 2.0, 3.0),
        correctors=("H", "V"),
        corrector_s=(1.5, 2.5),
        circumference=10.0,
        limit=18.0,
        period=0.1,
    )
    return PageJob(data_directory=directory, web=WebSettings(**web), layout=layout)


def answer(time: float = 100.0, rms: float = 1.0) -> dict[str, Any]:
    return {
        "time": time, "alive": True, "rms_um": {"x": rms / 2}, "rms_peak_um": {"x": rms},
        "floor_um": 0.2, "state": "CLOSED",
    }  # fmt: skip


class Service:
    """Answers as the service does, and counts; `problem` is raised instead."""

    def __init__(self) -> None:
        self.asked, self.answer = 0, answer()
        self.problem: Exception | None = None

    def __call__(self, request: dict[str, Any], _timeout: float) -> dict[str, Any]:
        assert request == {"command": "page"}
        self.asked += 1
        if self.problem is not None:
            raise self.problem
        return self.answer


def filled(job: PageJob, service: Service) -> Feed:
    """A feed that has asked once."""
    feed = Feed(job, service)
    asyncio.run(feed.once())
    return feed
