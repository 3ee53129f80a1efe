"""Arrays of the simulated ring over pvAccess, from the same board as those of Channel Access."""

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import OwnershipError, RingError
from orbitfb.core.names import NamedPv
from orbitfb.core.signals import Vector
from orbitfb.sim.access.board import Board
from orbitfb.sim.access.stamp import EPICS_EPOCH
from orbitfb.sim.layout import PvSpec

Put = Callable[[NDArray[np.intp], Vector], None]


def server_keys(interface: str, port: int) -> dict[str, str]:
    """Say where a server listens, in the words of EPICS.

    Args:
        interface: Its address; nothing is said on any other.
        port: Where searches come (UDP); 0: any free one. TCP takes a free one.
    """
    return {
        "EPICS_PVAS_INTF_ADDR_LIST": interface,
        "EPICS_PVAS_SERVER_PORT": "0",
        "EPICS_PVAS_BROADCAST_PORT": str(port),
        "EPICS_PVAS_AUTO_BEACON_ADDR_LIST": "NO",
        "EPICS_PVAS_BEACON_ADDR_LIST": interface,
    }


class PvaArrays:
    """Some arrays of a board.

    An array has the stamp of its first element, and no alarm: an element that must not be used is
    NaN.

    Args:
        pvs: Each with the places of its elements on the board.
        specs: Of what is on the board.
        board: Has the values.
        put: Puts setpoints in force.

    Raises:
        RingError: The extra `pva` is not installed.
    """

    def __init__(
        self, pvs: Sequence[NamedPv], specs: Sequence[PvSpec], board: Board, put: Put
    ) -> None:
        self._board, self._put = board, put
        self._nt, server = _p4p("nt"), _p4p("server.asyncio")
        self._server: Any = None
        self._type = self._nt.NTScalar("ad", display=True, control=True)
        self._shared: list[tuple[NDArray[np.intp], Any]] = []
        self._names: list[str] = []
        for pv in pvs:
            order = np.arange(1) if pv.elements is None else np.argsort(pv.elements)
            places = pv.places[order]
            shared = server.SharedPV(handler=_Handler(self, places), wrap=self._type.wrap)
            self._names.append(pv.served)
            self._shared.append((places, shared))
            self._open(shared, places, specs[int(places[0])])

    def start(self, interface: str, port: int) -> int:
        """Serve them.

        Args:
            interface: Address to listen on.
            port: Where searches come (UDP); 0: any free one.

        Returns:
            The port where searches come.

        Raises:
            OwnershipError: The server cannot start there.
        """
        shared = dict(zip(self._names, (its for _, its in self._shared), strict=True))
        try:
            self._server = _p4p("server").Server(
                providers=[shared], conf=server_keys(interface, port), useenv=False
            )
        except RuntimeError as cause:
            raise OwnershipError(
                f"pvAccess cannot be served on {interface}, UDP port {port}: {cause}; name another "
                "with sim.pva_port"
            ) from cause
        return int(self._server.conf()["EPICS_PVAS_BROADCAST_PORT"])

    def stop(self) -> None:
        """Serve them no more."""
        if self._server is not None:
            self._server.stop()

    def show(self, readings: bool) -> None:
        """Publish what is on the board.

        Args:
            readings: Whether that of a tick; else the setpoints.
        """
        for places, shared in self._shared:
            if (places[0] < self._board.readings) == readings:
                shared.post({"value": self._board.value[places]}, timestamp=self._stamp(places))

    def take(self, places: NDArray[np.intp], values: Vector) -> str:
        """Take all values that a client puts, or none.

        Args:
            places: Of the elements on the board, shape (k,).
            values: What it put.

        Returns:
            Why they are refused; empty: they are in force.
        """
        which = places - self._board.readings
        if which[0] < 0:
            return "is a reading: nobody writes it"
        if values.shape != which.shape or not self._board.allowed(which, values).all():
            return f"takes {len(which)} finite values within the drive limits"
        self._put(which, values)
        return ""

    def _open(self, shared: Any, places: NDArray[np.intp], spec: PvSpec) -> None:
        (low, high), (lowest, highest) = spec.display, spec.drive
        shared.open(
            {
                "value": self._board.value[places],
                "display": {"limitLow": low, "limitHigh": high, "units": spec.units},
                "control": {"limitLow": lowest, "limitHigh": highest},
            },
            timestamp=self._stamp(places),
        )

    def _stamp(self, places: NDArray[np.intp]) -> tuple[int, int]:
        seconds, nanoseconds = self._board.get(int(places[0])).stamp
        return seconds + EPICS_EPOCH, nanoseconds


class _Handler:
    """Takes the puts to one array, on the event loop."""

    def __init__(self, arrays: PvaArrays, places: NDArray[np.intp]) -> None:
        self._arrays, self._places = arrays, places

    def put(self, _pv: Any, operation: Any) -> None:
        """Answer a put."""
        values = np.array(operation.value()["value"], dtype=np.float64)
        refusal = self._arrays.take(self._places, values)
        operation.done(error=refusal or None)


def _p4p(module: str) -> Any:
    try:
        return importlib.import_module(f"p4p.{module}")
    except ImportError as cause:
        raise RingError(
            f"the places table names PVs of pvAccess, and the extra `pva` is not installed "
            f"({cause}); pip install 'orbitfb[pva]'"
        ) from cause
