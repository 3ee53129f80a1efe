"""Requests for a whole group at once: read values, read drive limits, put."""

import ctypes
from collections.abc import Callable
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import WriteError
from orbitfb.core.names import NamedPv
from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.channels import NOT_HEARD, ChannelGroup
from orbitfb.epics.libca import DBR_CTRL_DOUBLE, DBR_DOUBLE, ECA_NORMAL, ECA_TIMEOUT, Context
from orbitfb.safety.verdict import name_some

CONTROL_RECORD = np.dtype(
    {
        "names": ["units", "upper_limit", "lower_limit", "value"],
        "formats": ["S8", np.float64, np.float64, np.float64],
        "offsets": [8, 64, 72, 80],
        "itemsize": 88,
    }
)
"""`struct dbr_ctrl_double` (db_access.h), as far as it is used here."""


class Getter:
    """Asks for all values of a group in one request.

    Args:
        context: Context of the group.
        group: Whom to ask.
        timeout: How long to wait for the answers [s].
    """

    def __init__(self, context: Context, group: ChannelGroup, timeout: float) -> None:
        self._context = context
        self._group = group
        self._timeout = timeout

    def values(self) -> Vector:
        """Return the values of the group, shape (m,), in the unit of the PVs; NaN: no answer."""
        values = self._fetch(DBR_DOUBLE, np.full(len(self._group), np.nan))
        return np.where(np.isfinite(values), values, np.nan)

    def describe(self, silent: Mask) -> str:
        """Say that some did not answer, shape (m,)."""
        return (
            f"{np.count_nonzero(silent)} of {len(self._group)} PVs did not answer with a finite "
            f"value within {self._timeout:.1f} s: {name_some(silent, self._group.names)}; see "
            "whether their IOC runs"
        )

    def limits(self) -> NDArray[np.float64]:
        """Return the drive limits of the group.

        Returns:
            Shape (m, 2), low and high in the unit of the PVs; NaN where the server states none
            or does not answer.
        """
        records = self._fetch(DBR_CTRL_DOUBLE, np.zeros(len(self._group), dtype=CONTROL_RECORD))
        limits = np.stack([records["lower_limit"], records["upper_limit"]], axis=1)
        # A record without drive limits answers 0, 0.
        limits[~(limits[:, 0] < limits[:, 1])] = np.nan
        return limits

    def units(self) -> list[str]:
        """Return the units that the records state (EGU); empty where none or no answer."""
        records = self._fetch(DBR_CTRL_DOUBLE, np.zeros(len(self._group), dtype=CONTROL_RECORD))
        return [unit.decode("latin-1") for unit in records["units"].tolist()]

    def _fetch(self, kind: int, answers: NDArray[Any]) -> NDArray[Any]:
        answers = self._fetch_ca(kind, answers)
        pva = self._group.pva
        for number, held in {} if pva is None else pva.ask(pva.present, self._timeout).items():
            pv = self._group.pvs[number]
            if kind == DBR_DOUBLE:
                its = np.append(held.values, np.full(pv.length, np.nan))
                answers[pv.places] = its[0 if pv.elements is None else pv.elements]
            else:
                unit = held.units.replace("μ", "µ").encode("latin-1", "replace")
                answers["units"][pv.places] = unit
                answers["lower_limit"][pv.places], answers["upper_limit"][pv.places] = held.limits
        return answers

    def _fetch_ca(self, kind: int, answers: NDArray[Any]) -> NDArray[Any]:
        group, get = self._group, self._context.library.ca_array_get
        arrays: list[tuple[NamedPv, NDArray[Any]]] = []
        with self._context.asking, group.lock:
            present = [number for number in group.present if not group.pvs[number].over_pva]
            if not present:
                return answers
            self._context.attach()
            addresses = _addresses(answers)
            for number in present:
                # One that goes away just now is refused; its answer stays as it was.
                pv, count = group.pvs[number], 1
                if pv.elements is None:
                    address = addresses[pv.places[0]]
                else:
                    told = int(group.lengths[number])
                    if kind == DBR_DOUBLE:  # no more than it has told, or zeros would fill it up
                        count = pv.length if told == NOT_HEARD else min(pv.length, told)
                    answer = np.full(pv.length, answers[pv.places[0]], dtype=answers.dtype)
                    arrays.append((pv, answer))
                    address = answer.ctypes.data
                if count:
                    get(kind, count, group.handles[number], address)
            status = self._context.library.ca_pend_io(self._timeout)
        for pv, answer in arrays:
            elements = pv.elements if kind == DBR_DOUBLE else 0
            answers[pv.places] = answer[elements]
        if status == ECA_NORMAL:
            return answers
        # An answer that comes after all is still written there by libca: it must not be freed.
        self._context.abandoned += [answers, *(answer for _, answer in arrays)]
        if status != ECA_TIMEOUT:
            self._context.check("ca_pend_io", status)
        return answers.copy()


class Putter:
    """Puts one double to some or all names of a group and flushes once.

    An array is put as a whole, if one of its elements is to be put.

    Args:
        context: Context of the group.
        group: Where to put.
    """

    def __init__(self, context: Context, group: ChannelGroup) -> None:
        self._context = context
        self._group = group
        self._values = np.zeros(len(group))
        self._calls: list[tuple[Any, ...]] = []
        self._numbers: list[int] = []
        self._arrays: list[tuple[NamedPv, Vector]] = []
        self._over_pva: dict[int, Vector] = {}
        self._generation = -1
        # A function object of its own, without prototype: its arguments are converted beforehand.
        self._put: Callable[..., int] = context.library["ca_array_put"]

    def put(self, values: Vector, which: Mask) -> None:
        """Send values, shape (m,), in the unit of the PVs: all that are asked for, or none.

        Args:
            values: To send; also those of an array that is put for the sake of its others.
            which: Names to send to, shape (m,).

        Raises:
            WriteError: A channel is away, read-only or refuses; then nothing was sent, unless
                the message says so.
        """
        group = self._group
        with group.lock:
            ready = group.connected & group.writable
            if not (ready | ~which).all():
                raise WriteError(self._refusal(which))
            if self._generation != group.generation:
                self._prepare()
            self._values[:] = values
            for pv, array in self._arrays:
                array[[0] if pv.elements is None else pv.elements] = self._values[pv.places]
            self._context.attach()
            put, calls = self._put, self._calls
            if not which.all():
                pvs = group.pvs
                wanted = [bool(which[pvs[number].places].any()) for number in self._numbers]
                calls = list(compress(calls, wanted))
            for sent, call in enumerate(calls):
                if (status := put(*call)) != ECA_NORMAL:
                    self._refused(call, status, sent)
            self._context.flush()
            for number, array in self._over_pva.items():
                if group.pva is not None and which[group.pvs[number].places].any():
                    group.pva.put(number, array)

    def _prepare(self) -> None:
        kind, one = ctypes.c_long(DBR_DOUBLE), ctypes.c_ulong(1)
        addresses = _addresses(self._values)
        self._arrays, self._over_pva = [], {}
        self._calls, self._numbers = [], []
        for number, pv in enumerate(self._group.pvs):
            handle = ctypes.c_void_p(self._group.handles[number])
            if pv.elements is None and not pv.over_pva:
                address = ctypes.c_void_p(addresses[pv.places[0]])
                self._calls.append((kind, one, handle, address))
                self._numbers.append(number)
                continue
            array = np.zeros(pv.length)
            self._arrays.append((pv, array))
            if pv.over_pva:
                self._over_pva[number] = array
                continue
            address = ctypes.c_void_p(array.ctypes.data)
            self._calls.append((kind, ctypes.c_ulong(len(array)), handle, address))
            self._numbers.append(number)
        self._generation = self._group.generation

    def _refusal(self, which: Mask) -> str:
        group = self._group
        away = which & ~group.connected
        read_only = which & group.connected & ~group.writable
        parts = [
            f"{np.count_nonzero(mask)} of {len(group)} setpoints are {what}: "
            + name_some(mask, group.names)
            for mask, what in ((away, "disconnected"), (read_only, "read-only"))
            if mask.any()
        ]
        return "; ".join([*parts, "nothing was sent"])

    def _refused(self, call: tuple[Any, ...], status: int, before: int) -> None:
        number = self._numbers[self._calls.index(call)]
        sent = (
            "nothing was sent"
            if before == 0
            else f"{before} setpoints before it may have been sent: read them back"
        )
        raise WriteError(
            f"{self._group.pvs[number].name} refused: {self._context.message(status)}; {sent}"
        )


def _addresses(values: NDArray[Any]) -> list[int]:
    start, stride = values.ctypes.data, values.itemsize
    return [start + index * stride for index in range(values.size)]
