"""The texts of the lease over Channel Access."""

import ctypes
from collections.abc import Callable, Sequence
from time import sleep

from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import MachineError
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.lease.lease import LONGEST
from orbitfb.epics.libca import Context
from orbitfb.epics.network import environment_lock, use_network
from orbitfb.epics.settings import EpicsSettings

DBR_STRING = 0
_SIZE = 40
_LOOK = 0.01


class LeasePvs:
    """Text PVs, read and written together; one thread at a time.

    Args:
        names: The PVs.
        settings: Network and time limits.
        wait: How long to look for them [s].
    """

    def __init__(self, names: Sequence[str], settings: EpicsSettings, wait: float) -> None:
        self._timeout = settings.answer_timeout
        with environment_lock:
            use_network(settings)
            self._context = Context()
            self._group = ChannelGroup(self._context, names)
            self._group.open()
            self._await(wait)
        self._context.detach()
        # A function object of its own, without prototype: its arguments are converted beforehand.
        self._put: Callable[..., int] = self._context.library["ca_array_put"]

    @property
    def missing(self) -> tuple[str, ...]:
        """PVs that were not found, or may not be written."""
        return self._group.disconnected + self._group.read_only

    def read(self) -> tuple[str, ...]:
        """Read all of them.

        Raises:
            MachineError: One is away or does not answer.
        """
        self._reach()
        size = len(self._group)
        answers = ctypes.create_string_buffer(_SIZE * size)
        try:
            self._ask(answers)
        except MachineError:
            # An answer that comes after all is still written there by libca: it must not be freed.
            self._context.abandoned.append(answers)
            raise
        pieces = (answers.raw[start : start + _SIZE] for start in range(0, size * _SIZE, _SIZE))
        return tuple(piece.partition(b"\0")[0].decode("latin-1") for piece in pieces)

    def _ask(self, answers: ctypes.Array[ctypes.c_char]) -> None:
        """Have all values written to memory, one after the other."""
        with self._group.lock:
            self._context.attach()
            library = self._context.library
            for index, name in enumerate(self._group.names):
                address = ctypes.addressof(answers) + index * _SIZE
                handle = self._group.handles[index]
                self._context.check(
                    f"reading {name}", library.ca_array_get(DBR_STRING, 1, handle, address)
                )
            status = library.ca_pend_io(self._timeout)
        self._context.check("reading the lease", status)

    def write(self, text: str) -> None:
        """Write the same to all of them.

        Raises:
            MachineError: One is away or refuses.
        """
        self._reach()
        data = ctypes.create_string_buffer(text.encode("ascii", "replace")[:LONGEST], _SIZE)
        with self._group.lock:
            self._context.attach()
            for index, name in enumerate(self._group.names):
                handle = ctypes.c_void_p(self._group.handles[index])
                status = self._put(ctypes.c_long(DBR_STRING), ctypes.c_ulong(1), handle, data)
                self._context.check(f"writing {name}", status)
            self._context.flush()

    def close(self) -> None:
        """Let go of them."""
        self._group.forget()
        self._context.destroy()

    def _reach(self) -> None:
        if self._group.all_connected:
            return
        self._context.attach()
        self._group.reopen_away()
        self._await(self._timeout)
        if not self._group.all_connected:
            raise MachineError(f"{', '.join(self._group.disconnected)}: disconnected")

    def _await(self, time: float) -> None:
        clock = SystemClock()
        end = clock.monotonic() + time
        while not self._group.all_connected and clock.monotonic() < end:
            sleep(_LOOK)
