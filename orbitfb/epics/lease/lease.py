"""The lease: of all controllers that know a machine, one writes to it.

The lease is a text in PVs of the machine's IOC, one per plane: who holds it and a count that
grows, `HOST:PROCESS:TOKEN:COUNT`. It lives on that count and not on anybody's clock: whoever
wants the lease watches the text for `time`; if it changes meanwhile, its owner is alive.

Channel Access has no test-and-set, so that a taker writes, waits and reads back: of two that
write at once, the last one finds its own text. A holder that could not confirm the lease for
`time` (its process stood still, the network was away) does not write to the machine before it
has: somebody else may hold it by then. A holder that finds another text does not write either: if
that text grows its owner has the machine; if it stands still for `time` it is stale, as one that an
operator typed or an IOC brought back, and the lease is taken back.
"""

import os
import re
import secrets
import socket
import threading
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Protocol

from pydantic import Field

from orbitfb.core.errors import MachineError, OwnershipError
from orbitfb.core.names import LEASE_PV
from orbitfb.core.ports import Clock
from orbitfb.core.settings import Settings

LONGEST = 39
"""Longest text of an EPICS string [characters]."""
_COUNTS = 1_000_000


class LeaseSettings(Settings):
    """The lease of the machine."""

    pv: str = Field(
        default=LEASE_PV,
        max_length=60,
        description="Text PV of the machine's IOC that says who writes to it; % stands for the "
        "plane, X or Y; empty: none.",
    )
    required: bool = Field(
        default=False,
        description="Whether a machine without that PV is refused; else a message says so.",
    )
    time: float = Field(
        default=3.0,
        ge=0.5,
        le=3600.0,
        description="Time without a sign of life after which a lease is stale [s].",
    )
    wait: float = Field(
        default=0.5, gt=0, le=60.0, description="How long to look for the PV at start [s]."
    )

    def pvs(self, planes: str) -> tuple[str, ...]:
        """Give the PVs for planes."""
        names = (self.pv.replace("%", plane.upper()) for plane in planes)
        return tuple(dict.fromkeys(name for name in names if name))


class Board(Protocol):
    """Texts that every controller reads and writes."""

    def read(self) -> tuple[str, ...]:
        """Read all of them.

        Raises:
            MachineError: One cannot be read.
        """
        ...

    def write(self, text: str) -> None:
        """Write the same to all of them.

        Raises:
            MachineError: One cannot be written.
        """
        ...


class Sign(Enum):
    """What the texts tell of who holds the lease."""

    FREE = "nobody"
    OURS = "we"
    THEIRS = "somebody else"


class Lease:
    """A lease while it is held.

    Args:
        board: Where it is written.
        settings: Its time.
        clock: Monotonic.
        wait: Waits so long [s]; True: give up.
        lost: Told who took it, once.
    """

    def __init__(
        self,
        board: Board,
        settings: LeaseSettings,
        clock: Clock,
        wait: Callable[[float], bool],
        lost: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._board, self._time, self._clock, self._wait = board, settings.time, clock, wait
        self._lost = lost
        host = re.sub(r"[^A-Za-z0-9_.-]", "", socket.gethostname())[:15]
        self._self = f"{host}:{os.getpid()}:{secrets.token_hex(2)}"
        self._count = 0
        self._confirmed = float("-inf")
        self._taken_by = ""
        self._foreign: tuple[tuple[str, ...], float] | None = None
        self.trouble = ""
        """Why the lease could not be confirmed last; empty if it was."""

    @property
    def period(self) -> float:
        """Time between two signs of life [s]."""
        return self._time / 4

    @property
    def owner(self) -> str:
        """Who holds it, as far as is known."""
        return self._taken_by or self._self

    def take(self) -> str:
        """Take the lease.

        Returns:
            Whose stale lease was taken over; empty when it was free.

        Raises:
            OwnershipError: Somebody else holds it and lives.
            MachineError: It cannot be read or written.
        """
        first, begin = self._board.read(), self._clock.monotonic()
        now = first
        while self._sign(now) is Sign.THEIRS and self._clock.monotonic() - begin < self._time:
            if now != first:
                raise OwnershipError(_held(now))
            if self._wait(self.period / 4):
                raise OwnershipError("the wait for the lease of the machine was ended")
            now = self._board.read()
        if self._sign(now) is Sign.THEIRS and now != first:
            raise OwnershipError(_held(now))
        self._write()
        self._wait(self.period / 2)
        if self._sign(now := self._board.read()) is not Sign.OURS:
            raise OwnershipError(_held(now))
        self._confirmed = self._clock.monotonic()
        return _who(first) if self._sign(first) is Sign.THEIRS else ""

    def beat(self) -> None:
        """Give a sign of life, or find that the lease is lost."""
        if self._taken_by:
            return
        try:
            now = self._board.read()
            if self._sign(now) is Sign.THEIRS:
                self._watch(now)
                return
            self._foreign = None
            self._write()  # also anew where an IOC has come back without it
            self._confirmed = self._clock.monotonic()
            self.trouble = ""
        except MachineError as error:
            self.trouble = str(error)

    def _watch(self, texts: tuple[str, ...]) -> None:
        """Look whether a foreign text lives: give the machine up, wait, or take a stale one back.

        What is taken back is ours when the next sign of life finds it so.
        """
        now = self._clock.monotonic()
        if self._foreign is None:
            self._foreign = texts, now
            return
        first, since = self._foreign
        if texts != first:
            self._give_up(texts)
        elif now - since >= self._time:
            self._confirmed = float("-inf")
            self._write()

    def refusal(self) -> str:
        """Say why the machine must not be written to now; empty when it may."""
        if self._taken_by:
            return (
                f"the lease of the machine was taken by {self._taken_by}; this controller does not "
                "take it back: end the other one, then start this one again"
            )
        if self._foreign is not None:
            text = ", ".join(dict.fromkeys(filter(None, self._foreign[0])))
            return (
                f"the lease of the machine reads {text}, which is not of this controller; it is "
                f"taken back if that stands still for {self._time:.3g} s"
            )
        age = self._clock.monotonic() - self._confirmed
        if age < self._time:
            return ""
        because = f": {self.trouble}" if self.trouble else ""
        return f"the lease of the machine is not confirmed for {age:.3g} s{because}"

    def release(self) -> None:
        """Give it back if it is ours; a lease that cannot be given back becomes stale."""
        if self._taken_by:
            return
        try:
            if self._sign(self._board.read()) is Sign.OURS:
                self._board.write("")
        except MachineError as error:
            self.trouble = str(error)

    def _give_up(self, texts: Sequence[str]) -> None:
        """Leave the machine to those whom texts name."""
        self._taken_by = _who(texts)
        self._lost(self._taken_by)

    def _write(self) -> None:
        self._count = (self._count + 1) % _COUNTS
        self._board.write(f"{self._self}:{self._count}")

    def _sign(self, texts: Sequence[str]) -> Sign:
        held = [text for text in texts if text]
        if any(not text.startswith(f"{self._self}:") for text in held):
            return Sign.THEIRS
        return Sign.OURS if len(held) == len(texts) else Sign.FREE


def _who(texts: Sequence[str]) -> str:
    """Give the owners that texts name, without their counts."""
    return ", ".join(dict.fromkeys(text.rpartition(":")[0] or text for text in texts if text))


def _held(texts: Sequence[str]) -> str:
    return (
        f"the machine is under the control of {_who(texts)} (host:process:token), whose lease is "
        "alive; stop that one first: two loops on one ring fight each other"
    )


class LeaseThread:
    """Gives signs of life until it is stopped.

    Args:
        lease: A lease that is held, or looked for.
        stop: Set when it is stopped; what the lease waits for may end with it.
    """

    def __init__(self, lease: Lease, stop: threading.Event | None = None) -> None:
        self._lease = lease
        self._stop = stop or threading.Event()
        self._thread = threading.Thread(target=self._run, name="lease", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it and give the lease back."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(self._lease.period):
            self._lease.beat()
        self._lease.release()
