"""Memory of answers that come after nobody waits for them any more."""

import ctypes
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orbitfb.core.errors import MachineError
from orbitfb.core.names import named_pvs
from orbitfb.epics.channels import NOT_HEARD
from orbitfb.epics.lease.pvs import LeasePvs
from orbitfb.epics.libca import ECA_NORMAL, ECA_TIMEOUT
from orbitfb.epics.requests import Getter

NAMES = ("A", "B", "C.[0]", "C.[2]")


class Late:
    """A libca that answers when nobody waits any more."""

    def __init__(self) -> None:
        self.addresses: list[int] = []

    def ca_array_get(self, _kind: int, _count: int, _handle: int, address: int) -> int:
        self.addresses.append(address)
        return ECA_NORMAL

    def ca_pend_io(self, _timeout: float) -> int:
        return ECA_TIMEOUT


class Group:
    """As much of a group of channels as is asked: two scalars, and two elements of an array."""

    names, lock, pvs, handles = NAMES, nullcontext(), named_pvs(NAMES), tuple(range(4))
    connected = np.ones(len(NAMES), dtype=bool)
    pva = None
    lengths, present = np.full(3, NOT_HEARD), [0, 1, 2]

    def __len__(self) -> int:
        return len(NAMES)


def check(call: str, status: int) -> None:
    if status != ECA_NORMAL:
        raise MachineError(call)


def late_context() -> Any:
    return SimpleNamespace(
        library=Late(), abandoned=[], asking=nullcontext(), attach=lambda: None, check=check
    )


def owned(kept: list[Any], address: int) -> bool:
    """Whether memory that is kept has this address."""
    for memory in kept:
        is_array = isinstance(memory, np.ndarray)
        start = memory.ctypes.data if is_array else ctypes.addressof(memory)
        size = memory.nbytes if is_array else ctypes.sizeof(memory)
        if start <= address < start + size:
            return True
    return False


@pytest.mark.parametrize("ask", [Getter.values, Getter.limits, Getter.units])
def test_answers_that_come_late_are_written_to_memory_that_outlives_who_asked(
    ask: Callable[[Getter], object],
):
    context, group = late_context(), cast(Any, Group())
    ask(Getter(context, group, 0.1))  # and nobody keeps the getter
    assert len(context.library.addresses) == 3
    assert all(owned(context.abandoned, address) for address in context.library.addresses)


def test_so_are_those_of_the_lease():
    context, group = late_context(), cast(Any, Group())
    lease = LeasePvs.__new__(LeasePvs)
    lease._context, lease._group, lease._timeout = context, group, 0.1
    lease._reach = lambda: None
    with pytest.raises(MachineError):
        lease.read()
    assert all(owned(context.abandoned, address) for address in context.library.addresses)


class Counting:
    """A libca that counts the answers that are awaited, those of all threads together."""

    def __init__(self) -> None:
        self.askers: set[int] = set()
        self.mixed = False

    def ca_array_get(self, _kind: int, _count: int, _handle: int, _address: int) -> int:
        self.askers.add(threading.get_ident())
        self.mixed |= len(self.askers) > 1
        return ECA_NORMAL

    def ca_pend_io(self, _timeout: float) -> int:
        time.sleep(0.01)
        self.askers.clear()
        return ECA_NORMAL


def test_two_threads_never_await_answers_at_once():
    """The end of one wait would be taken for that of the other, whose memory is then written to."""
    context = late_context()
    context.library, context.asking = Counting(), threading.Lock()

    def ask() -> None:
        getter = Getter(context, cast(Any, OwnGroup()), 0.1)
        for _ in range(5):
            getter.limits()

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not context.library.mixed


class OwnGroup(Group):
    """A group with a lock of its own."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
