"""The channels of one group that are reached over pvAccess.

A monitor of p4p brings values, alarm, stamp, unit and limits together, and tells when its server
has gone; p4p searches for it again by itself. Whether a PV may be written is not told before
somebody tries: a put that is refused is told as one of Channel Access is.
"""

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, SimpleQueue
from threading import Event, Lock
from time import monotonic
from typing import Any, Protocol

from orbitfb.core.errors import WriteError
from orbitfb.core.names import NamedPv
from orbitfb.core.signals import Vector
from orbitfb.epics.libca import keep_thread_state
from orbitfb.epics.pva.held import Held
from orbitfb.epics.pva.provider import p4p

REQUEST = "field(value)record[block=false,process=passive]"
"""Of a put: the record is processed as by one over Channel Access, and nobody waits for it."""


class PvaListener(Protocol):
    """Who is told what happens, by number of the PV; called by one thread at a time."""

    def pva_came(self, number: int) -> None:
        """Take that a PV is connected."""
        ...

    def pva_gone(self, number: int) -> None:
        """Take that it is away."""
        ...

    def pva_told(self, number: int, held: Held, changed: bool) -> None:
        """Take a new value; changed: it states another unit or other limits than before."""
        ...

    def pva_refused(self, number: int, words: str) -> None:
        """Take that its server refuses a put."""
        ...


@dataclass(slots=True, eq=False)
class _Put:
    """A put that is under way."""

    number: int
    operation: Any = None
    done: bool = False
    void: bool = False
    sent: Event = field(default_factory=Event)


class PvaChannels:
    """Some PVs over pvAccess.

    Args:
        client: Of p4p, as `pva_client` makes it.
        lock: Held while something is told.
        pvs: By number.
        listener: Is told what happens.
    """

    def __init__(
        self,
        client: Any,
        lock: Lock,
        pvs: Mapping[int, NamedPv],
        listener: PvaListener,
    ) -> None:
        self._client, self._lock, self._pvs, self._listener = client, lock, dict(pvs), listener
        raw = p4p("client.raw")
        self._cancelled: type[Exception] = raw.Cancelled
        self._request = raw.Context.makeRequest(REQUEST)
        self._monitors: dict[int, Any] = {}
        self._held: dict[int, Held] = {}
        self._puts: list[_Put] = []

    @property
    def present(self) -> tuple[int, ...]:
        """Numbers of those that are connected."""
        return tuple(self._held)

    @property
    def kinds(self) -> dict[int, int]:
        """Native types of those that are connected, by number, as db_access.h has them."""
        return {number: held.kind for number, held in list(self._held.items())}

    @property
    def sizes(self) -> dict[int, int]:
        """Counts of values of those that are connected, by number."""
        return {number: len(held.values) for number, held in list(self._held.items())}

    def open(self) -> None:
        """Begin to search and to listen."""
        for number in self._pvs:
            self._listen(number)

    def search(self) -> None:
        """Search anew for those that are away.

        p4p searches for a lost one at intervals that grow to 30 s; for a new one it begins at once.
        """
        for number in self._pvs.keys() - self._held.keys():
            self._monitors[number].close()
            self._client.disconnect(self._pvs[number].served)
            self._listen(number)

    def ask(self, numbers: Iterable[int], timeout: float) -> dict[int, Held]:
        """Ask servers for what PVs hold now.

        Args:
            numbers: Whom to ask.
            timeout: How long to wait for all answers together [s].

        Returns:
            By number, those that answered.
        """
        answers: SimpleQueue[tuple[int, Any]] = SimpleQueue()

        def answer(number: int, told: Any) -> None:
            answers.put((number, told))

        asked = [
            self._client.get(self._pvs[number].served, partial(answer, number))
            for number in list(numbers)
        ]
        found: dict[int, Held] = {}
        deadline = monotonic() + timeout
        try:
            for _ in asked:
                number, told = answers.get(timeout=max(deadline - monotonic(), 0.0))
                if told is not None and not isinstance(told, Exception):
                    found[number] = Held()
                    found[number].take(told)
        except Empty:
            pass  # the rest does not answer
        finally:
            for operation in asked:
                operation.close()
        return found

    def put(self, number: int, values: Vector) -> None:
        """Send values; what becomes of it is told when it is refused.

        p4p asks for the values on its own thread, once the server has said what the PV is. That is
        waited for, or else this thread would keep the interpreter to itself meanwhile.

        Args:
            number: Where to.
            values: All of the array, shape (k,).

        Raises:
            WriteError: It went away just now.
        """
        over = [put for put in self._puts if put.done or put.void]
        for put in over:
            put.operation.close()
        self._puts = [put for put in self._puts if put not in over]
        pv = self._pvs[number]
        value: Any = float(values[0]) if pv.elements is None else values.copy()
        put = _Put(number)

        def build(structure: Any) -> None:
            if put.void:
                raise WriteError(f"{pv.name} was away meanwhile")
            structure["value"] = value
            put.sent.set()

        self._puts.append(put)
        put.operation = self._client.put(
            pv.served,
            partial(self._answered, put),
            builder=build,
            request=self._request,
            get=False,
        )
        if number not in self._held:
            put.void = True
            raise WriteError(f"{pv.name} goes away while it is put: read all setpoints back")
        put.sent.wait(sys.getswitchinterval())

    def close(self) -> None:
        """Listen no more, and let no put be under way."""
        for monitor in self._monitors.values():
            monitor.close()
        for put in self._puts:
            put.operation.close()
        self._puts = []

    def _listen(self, number: int) -> None:
        name = self._pvs[number].served
        self._monitors[number] = self._client.monitor(name, partial(self._wake, number))
        self._wake(number)  # it may have told something before it was known here

    def _wake(self, number: int) -> None:
        with self._lock:
            monitor = self._monitors.get(number)
            while monitor is not None and (event := monitor.pop()) is not None:
                if isinstance(event, Exception):
                    self._gone(number)
                else:
                    self._told(number, event)

    def _gone(self, number: int) -> None:
        if self._held.pop(number, None) is None:
            return
        # p4p would send them when the server is back, at another time. It must not be asked to
        # cancel them here, while it takes the connection down.
        for put in self._puts:
            put.void |= put.number == number
        self._listener.pva_gone(number)

    def _told(self, number: int, event: Any) -> None:
        here = self._held.get(number)
        held = Held() if here is None else here
        changed = held.take(event)
        if here is None:
            keep_thread_state()
            self._held[number] = held
            self._listener.pva_came(number)
        self._listener.pva_told(number, held, changed and here is not None)

    def _answered(self, put: _Put, result: Any) -> None:
        put.done = True
        put.sent.set()
        if (
            not put.void
            and isinstance(result, Exception)
            and not isinstance(result, self._cancelled)
        ):
            self._listener.pva_refused(put.number, str(result))
