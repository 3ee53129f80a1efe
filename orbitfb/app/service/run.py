"""The service from start to exit code: it starts, runs until something ends it, and stops."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import structlog

from orbitfb.app.service.assemble import Service
from orbitfb.app.setup.heap import give_large_blocks_back
from orbitfb.app.setup.production_guard import check_live, pvs_of
from orbitfb.app.setup.startup import check_duration, find_ring, start_state
from orbitfb.app.setup.stop_signals import StopSignals
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import MachineError, OrbitFeedbackError
from orbitfb.core.signals import LoopState
from orbitfb.observe.logs import log_is_open
from orbitfb.observe.statistics.summary import check_place, write_summary
from orbitfb.observe.wording import clock_time

_log = structlog.stdlib.get_logger("orbitfb.service")


def run_service(
    config: AppConfig,
    ioc: str,
    start: str | None = None,
    duration: float | None = None,
    summary_file: Path | None = None,
    announce: Callable[[str], None] = lambda _: None,
    excite: Path | None = None,
    live: bool = False,
    asked: bool = False,
) -> int:
    """Run the loop until a signal, the end of the duration, or FAULT.

    Args:
        config: The configuration.
        ioc: `sim`, `env`, `config` or `HOST[:PORT]`.
        start: State to start in; by default CLOSED on a simulated ring of our own, else OPEN.
        duration: Time to run [s]; None: until a signal.
        summary_file: Where to write the figures of the run.
        announce: Gets a few lines about what was started where.
        excite: File of an excitation, to be done once.
        live: Whether the port of production is meant; then the loop starts OPEN.
        asked: Whether the kind of policy was asked for at this start.

    Returns:
        The exit code: 0, or 1 after FAULT.

    Raises:
        OrbitFeedbackError: It could not start, or its simulated ring died and none came back;
            nothing is left running.
    """
    begun = time.monotonic()
    give_large_blocks_back()
    state = LoopState.OPEN if live and start is None else start_state(start, ioc)
    check_live(find_ring(config, ioc), ioc, start, live, pvs_of(config))
    check_duration(duration)
    if summary_file is not None:
        check_place(summary_file)
    with StopSignals() as signals, ExitStack() as stack:
        try:
            service = Service(config, ioc, state, duration, stack, excite, announce, asked)
        except OrbitFeedbackError as error:
            if log_is_open():
                _log.error("start_failed", problem=str(error))
            raise
        service.announce(announce)
        announce(f"started after {time.monotonic() - begun:.1f} s")
        if live:
            announce("live: the loop is OPEN and writes nothing; `orbitfb command close` closes it")
        signals.hand_over()
        service.run(signals.stop, duration)
    final = service.final
    announce(
        f"stopped after {clock_time(final.duration)}, the loop was {service.runner.state}; "
        "the setpoints stay where they are"
    )
    if summary_file is not None:
        write_summary(summary_file, final)
    if service.ring_failure and service.runner.state is LoopState.HELD:
        raise MachineError(service.ring_failure)
    return 1 if service.runner.state is LoopState.FAULT else 0
