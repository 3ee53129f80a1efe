"""`orbitfb` with its page in a thread of the service: what was decided against, to be measured."""

import asyncio
import sys
import threading
from contextlib import ExitStack
from typing import Any

import orbitfb.app.service.interfaces
from orbitfb.cli.app import main
from orbitfb.config.tree import AppConfig
from orbitfb.core.signals import Channels
from orbitfb.page.job import PageJob, PageLayout
from orbitfb.page.server import serve


class PageInThread:
    """Stands in for the page of the service's own."""

    def __init__(
        self, config: AppConfig, channels: Channels, _statistics: Any, _stack: ExitStack
    ) -> None:
        layout = PageLayout.of(
            config.ring.load(), channels, config.limits.setpoint, config.loop.period
        )
        job = PageJob(data_directory=config.data_directory.resolve(), web=config.web, layout=layout)
        ready = threading.Event()
        self.where, self.problem = "", ""

        def announce(port: int, _bpms: int) -> None:
            self.where = f"http://{config.web.host}:{port}/"
            ready.set()

        def run() -> None:
            asyncio.run(serve(job, announce, asyncio.Event()))

        threading.Thread(target=run, name="page", daemon=True).start()
        ready.wait(20.0)


if __name__ == "__main__":
    setattr(orbitfb.app.service.interfaces, "PageProcess", PageInThread)  # noqa: B010 - another class on purpose
    sys.exit(main())
