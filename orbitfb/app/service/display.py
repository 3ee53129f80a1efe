"""What a service shows: metrics and health over HTTP, and its state in the terminal."""

from contextlib import ExitStack

from orbitfb.app.service.access import RingAccess
from orbitfb.app.service.interfaces import Opened
from orbitfb.app.service.loop import Loop
from orbitfb.app.service.observers import Observers
from orbitfb.app.service.reports import beside
from orbitfb.config.tree import AppConfig
from orbitfb.observe.http import ObserveServer
from orbitfb.observe.metrics.collector import metrics_registry
from orbitfb.observe.terminal import Terminal
from orbitfb.observe.view import Surroundings


def show(
    config: AppConfig,
    access: RingAccess,
    observers: Observers,
    loop: Loop,
    opened: Opened,
    duration: float | None,
    stack: ExitStack,
) -> ObserveServer:
    """Show the service from now on; gives where the metrics are.

    Args:
        config: The configuration.
        access: The ring as the service reaches it.
        observers: Have the figures.
        loop: The loop.
        opened: The doors, which tell what does not work.
        duration: Time to run [s]; None: until stopped.
        stack: Ends it.
    """
    figures, archive = observers.statistics.snapshot, observers.archive
    registry = metrics_registry(
        figures,
        archive.status,
        observers.recorders[0].status if observers.recorders else None,
        beside(
            config,
            access.machine,
            loop.dither,
            observers.clocks,
            observers.statistics,
            lambda: loop.runner.believed,
            lambda: loop.frequency.sight,
        ),
    )
    http = ObserveServer(config.observe, registry, figures, lambda: opened.troubles)
    http.start()
    stack.callback(http.stop)
    terminal = Terminal(
        figures,
        config.observe.terminal,
        Surroundings(
            metrics=http.address,
            duration=duration,
            ring=access.place,
            trouble=lambda: access.failure or archive.status().problem,
        ),
    )
    terminal.start()
    stack.callback(terminal.stop)
    return http
