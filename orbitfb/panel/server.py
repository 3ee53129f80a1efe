"""The panel's server: shows what the service says, hands on what clients write."""

import asyncio
import json
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from orbitfb.control.client import ask
from orbitfb.core.bursts import Bursts
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ControlError, OrbitFeedbackError
from orbitfb.panel.access import read_access
from orbitfb.panel.channels import Origin, channel_of, claimed, show
from orbitfb.panel.circuit import PanelContext
from orbitfb.panel.job import PanelJob
from orbitfb.panel.pv import PanelPv, request_of
from orbitfb.panel.pv_table import panel_pvs, writable_names
from orbitfb.sim.access.listening import Sockets, claim

ANSWER_TIMEOUT = 60.0
"""How long the service may take for a command, a refit above all [s]."""
LOOK_TIMEOUT = 5.0
"""How long it may take to say how it is [s]."""
_THREADS = 8
_PATIENCE = 0.3
SEND_BUFFER = 1 << 17


class Panel:
    """Serves the PVs of one service.

    Args:
        job: What to serve.
        ask_service: Asks the service: request and time limit [s] in, answer out.

    Raises:
        ConfigError: A rule is wrong.
    """

    def __init__(
        self, job: PanelJob, ask_service: Callable[[dict[str, Any], float], Mapping[str, Any]]
    ) -> None:
        settings = job.panel
        self.pvs = panel_pvs(settings, job.extent)
        self._prefix, self._period, self._still = settings.prefix, settings.period, job.still
        self._access = read_access(settings.rules, settings.interface, writable_names(self.pvs))
        self._ask = ask_service
        self._channels = {pv.name: channel_of(pv, self) for pv in self.pvs}
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="panel")
        self._looking = asyncio.Lock()
        self._beats = 0
        self._unset = {pv.name for pv in self.pvs if pv.name.endswith("-SP")}
        self._unsure: set[str] = set()
        self._telling: set[asyncio.Task[None]] = set()
        self._refusals = Bursts(SystemClock())

    def context(self, sockets: Sockets) -> PanelContext:
        """Make the caproto server that serves it."""
        named = {self._prefix + name: channel for name, channel in self._channels.items()}
        return PanelContext(named, sockets, max(pv.length for pv in self.pvs), self.dropped)

    def may_write(self, pv: PanelPv, origin: Origin) -> bool:
        """Ask the rules."""
        return self._access.may_write(pv.name, origin.user, origin.address)

    async def obey(self, pv: PanelPv, value: Any, origin: Origin) -> None:
        """Have the service do what was written.

        Where it does not say in time that it has, it may do so later: until the next write that
        it acknowledges, the PV shows what is in force.
        """
        request = request_of(pv, value)
        if request is None:
            return
        self._unset.discard(pv.name)
        told = {"user": origin.user, "host": origin.address, "pv": self._prefix + pv.name}
        self._unsure.add(pv.name)
        await self._in_thread({**request, "origin": told}, ANSWER_TIMEOUT)
        self._unsure.discard(pv.name)
        await self.look()  # what is acknowledged shows in the readbacks

    def refused(self, pv: PanelPv, value: Any, origin: Origin, reason: str) -> None:
        """Have the service log a write that was refused here."""
        self._refuse(origin.user, origin.address, self._prefix + pv.name, reason)

    def dropped(self, address: str, user: str, reason: str) -> None:
        """Have the service log that a client was hung up on."""
        self._refuse(claimed(user), address, "", f"hung up on: {reason}")

    def _refuse(self, user: str, address: str, pv: str, reason: str) -> None:
        """Tell the first refusals of a host at once, and count what follows for a while."""
        if self._refusals.add(address, reason):
            self._report({"user": user, "host": address, "pv": pv}, reason, 1)

    def _report(self, told: dict[str, str], reason: str, times: int) -> None:
        request = {"command": "refused", "reason": reason, "times": times, "origin": told}
        task = asyncio.get_running_loop().create_task(self._tell(request))
        self._telling.add(task)
        task.add_done_callback(self._telling.discard)

    async def keep_showing(self) -> None:
        """Show what the service says, again and again."""
        names = json.dumps([self._prefix + pv.name for pv in self.pvs])
        await self._channels["PVs-I"].write(names)
        for name, values in self._still.items():
            await show(self._channels[name], list(values))
        while True:
            await self.look()
            for address, reason, times in self._refusals.due():
                self._report({"user": "", "host": address, "pv": ""}, reason, times)
            await asyncio.sleep(self._period)

    async def look(self) -> None:
        """Ask the service how it is and show it; what is not known is INVALID."""
        async with self._looking:  # an older answer must not be shown after a newer one
            await self._look()

    async def _look(self) -> None:
        try:
            answer = await self._in_thread({"command": "panel"}, LOOK_TIMEOUT)
        except ControlError as error:
            for name in ("State-I", "Heartbeat-I"):
                await show(self._channels[name], None)
            await show(self._channels["Reason-I"], f"the service does not answer: {error}")
            return
        alive = bool(answer["alive"])
        self._beats = (self._beats + alive) % (1 << 31)
        figures = {**answer["figures"], "Heartbeat-I": self._beats if alive else None}
        for name, value in figures.items():
            if name in self._channels:
                await show(self._channels[name], value)
            wish = name.removesuffix("-RB") + "-SP"
            follows = wish in self._unset or wish in self._unsure
            if name.endswith("-RB") and follows and value is not None:
                await show(self._channels[wish], value)  # nobody has written it, or in doubt
                self._unset.discard(wish)

    def close(self) -> None:
        """Wait for nothing any more."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    async def _tell(self, request: dict[str, Any]) -> None:
        try:
            await self._in_thread(request, LOOK_TIMEOUT)
        except ControlError:
            return  # the service is gone; there is no log to write to

    async def _in_thread(self, request: dict[str, Any], timeout: float) -> Mapping[str, Any]:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._pool, self._ask, request, timeout)


async def serve(job: PanelJob, announce: Callable[[int, int], None], stop: asyncio.Event) -> None:
    """Serve a panel until told to stop.

    Args:
        job: What to serve.
        announce: Gets the port and the number of PVs once clients can connect.
        stop: Ends it when set.

    Raises:
        OrbitFeedbackError: A rule is wrong, or somebody else has the port.
    """
    panel = Panel(job, partial(_ask_service, job))
    sockets = claim(job.panel.interface, job.panel.port, SEND_BUFFER, "panel")
    ready = asyncio.Event()

    async def note_startup(_library: object) -> None:
        ready.set()

    tasks: list[asyncio.Task[Any]] = []
    try:
        tasks.append(asyncio.create_task(panel.context(sockets).run(startup_hook=note_startup)))
        tasks.append(asyncio.create_task(ready.wait()))
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        if ready.is_set():
            announce(sockets.port, len(panel.pvs))
        ends = [tasks[0], asyncio.create_task(panel.keep_showing())]
        ends.append(asyncio.create_task(stop.wait()))
        tasks.extend(ends[1:])
        await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        for end in ends:
            if end.done() and not end.cancelled() and (failure := end.exception()):
                raise failure
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks, timeout=_PATIENCE)
        panel.close()
        sockets.close()


def _ask_service(job: PanelJob, request: dict[str, Any], timeout: float) -> Mapping[str, Any]:
    try:
        return ask(job.data_directory, request, timeout)
    except ControlError:
        raise
    except OrbitFeedbackError as error:
        raise ControlError(str(error)) from None
