"""The part of the C library of Channel Access that is called without pyepics' wrapping.

pyepics finds, loads and initialises libca. Its own calls are too dear for 180 scalars per tick:
a monitor costs 15 to 35 µs there and below 1 µs here, 180 puts 20 ms there and 0.2 ms here. The
prototypes are those of cadef.h, bound to a second handle of the same library, so that pyepics'
own are not touched.
"""

import atexit
import ctypes
import importlib
import os
import threading
from collections.abc import Callable
from types import ModuleType
from typing import Any

from orbitfb.core.errors import MachineError

ECA_NORMAL = 1
ECA_TIMEOUT = 80
ECA_DOUBLED = 200
"""`ECA_DBLCHNL`: the same PV on several servers."""
OPERATION_UP = 6
DBR_FLOAT = 2
DBR_DOUBLE = 6
DBR_TIME_DOUBLE = 20
DBR_CTRL_DOUBLE = 34
MONITOR_VALUE_AND_ALARM = 1 | 4
MONITOR_PROPERTY = 8
"""Unit or limits have changed; servers before EPICS 3.14.11 do not tell."""
WRITE_ACCESS = 2


class EventArguments(ctypes.Structure):
    """`struct event_handler_args`."""

    _fields_ = (
        ("user", ctypes.c_void_p),
        ("channel", ctypes.c_void_p),
        ("type", ctypes.c_long),
        ("count", ctypes.c_long),
        ("data", ctypes.c_void_p),
        ("status", ctypes.c_int),
    )


class ConnectionArguments(ctypes.Structure):
    """`struct connection_handler_args`."""

    _fields_ = (("channel", ctypes.c_void_p), ("operation", ctypes.c_long))


class AccessArguments(ctypes.Structure):
    """`struct access_rights_handler_args`."""

    _fields_ = (("channel", ctypes.c_void_p), ("rights", ctypes.c_uint))


class ExceptionArguments(ctypes.Structure):
    """`struct exception_handler_args`."""

    _fields_ = (
        ("user", ctypes.c_void_p),
        ("channel", ctypes.c_void_p),
        ("type", ctypes.c_long),
        ("count", ctypes.c_long),
        ("data", ctypes.c_void_p),
        ("status", ctypes.c_long),
        ("operation", ctypes.c_long),
        ("context", ctypes.c_char_p),
        ("file", ctypes.c_char_p),
        ("line", ctypes.c_uint),
    )


EVENT_HANDLER = ctypes.CFUNCTYPE(None, EventArguments)
CONNECTION_HANDLER = ctypes.CFUNCTYPE(None, ConnectionArguments)
ACCESS_HANDLER = ctypes.CFUNCTYPE(None, AccessArguments)
EXCEPTION_HANDLER = ctypes.CFUNCTYPE(None, ExceptionArguments)

END_TIMEOUT = 2.0
"""How long a context with name servers may take to end [s]: one whose servers answer takes 5 ms."""

_LONGEST_HOST = 256
"""Bytes of a host name with its port; DNS allows 253 characters and libca keeps fewer."""

_PRINT_HANDLER = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)


@_PRINT_HANDLER
def _print_nothing(_format: int, _arguments: int) -> int:
    return 0


# ctypes' own memmove gives up the interpreter lock around the call; 24 bytes are not worth it.
move_memory = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)(
    ctypes.cast(ctypes.memmove, ctypes.c_void_p).value or 0
)


def keep_thread_state() -> None:
    """Let the calling thread of libca, or of p4p, keep its Python thread state until it ends.

    ctypes would make one and destroy it around every callback, which costs 7 µs instead of 0.8.
    The interpreter lock itself is still given up between callbacks: only the count of claims on
    the state stays above zero.
    """
    ctypes.pythonapi.PyGILState_Ensure()


def pyepics() -> ModuleType:
    """Import pyepics' Channel Access layer and initialise libca.

    Raises:
        MachineError: libca cannot be loaded.
    """
    layer = importlib.import_module("epics.ca")
    if layer.libca is None:
        try:
            layer.initialize_libca()
        except layer.ChannelAccessException as cause:
            message = f"pyepics cannot load libca ({cause}); reinstall pyepics or set PYEPICS_LIBCA"
            raise MachineError(message) from cause
        # At the end of the process pyepics would end a context that nobody used; where there are
        # name servers libca waits for that for ever. Our contexts end with whoever made them.
        atexit.unregister(layer.finalize_libca)
    return layer


def bind(path: str) -> ctypes.CDLL:
    """Open a library that is already loaded once more, with prototypes of our own."""
    library = ctypes.CDLL(path)
    pointer, text = ctypes.c_void_p, ctypes.c_char_p
    library.ca_context_create.argtypes = [ctypes.c_int]
    library.ca_current_context.restype = pointer
    library.ca_current_context.argtypes = []
    library.ca_attach_context.argtypes = [pointer]
    library.ca_replace_printf_handler.argtypes = [pointer]
    library.eltc.argtypes = [ctypes.c_int]
    library.ca_create_channel.argtypes = [
        text, pointer, pointer, ctypes.c_uint, ctypes.POINTER(pointer)
    ]  # fmt: skip
    library.ca_clear_channel.argtypes = [pointer]
    library.ca_add_exception_event.argtypes = [pointer, pointer]
    library.ca_get_host_name.argtypes = [pointer, ctypes.c_char_p, ctypes.c_uint]
    library.ca_puser.argtypes = [pointer]
    library.ca_puser.restype = pointer
    library.ca_write_access.argtypes = [pointer]
    library.ca_element_count.argtypes = [pointer]
    library.ca_element_count.restype = ctypes.c_ulong
    library.ca_field_type.argtypes = [pointer]
    library.ca_field_type.restype = ctypes.c_short
    library.ca_replace_access_rights_event.argtypes = [pointer, pointer]
    library.ca_create_subscription.argtypes = [
        ctypes.c_long, ctypes.c_ulong, pointer, ctypes.c_long, pointer, pointer, pointer
    ]  # fmt: skip
    library.ca_clear_subscription.argtypes = [pointer]
    library.ca_array_get.argtypes = [ctypes.c_long, ctypes.c_ulong, pointer, pointer]
    library.ca_pend_io.argtypes = [ctypes.c_double]
    library.ca_flush_io.argtypes = []
    library.ca_message.argtypes = [ctypes.c_long]
    library.ca_message.restype = text
    return library


class Context:
    """A Channel Access context of its own, with its threads.

    A context is left with its threads by whoever made it: all handlers have returned, and none
    is called any more, when `destroy` returns.

    Args:
        pva: Client of pvAccess for the same groups (`pva_client`); None: there is none.
    """

    def __init__(self, pva: Any = None) -> None:
        self.pva = pva
        self.telling = None if pva is None else threading.Lock()
        """Held by handlers where there are two kinds of threads that call them."""
        layer = pyepics()
        self.library = bind(layer.libca._name)
        # The thread may be in another machine's context, or in pyepics' own; leave that alone.
        self.library.ca_detach_context()
        self.check("ca_context_create", self.library.ca_context_create(1))
        self._handle: int = self.library.ca_current_context()
        self._has_name_servers = bool(os.environ.get("EPICS_CA_NAME_SERVERS"))
        self.library.ca_replace_printf_handler(_print_nothing)
        # A circuit that breaks is told past that handler, to the terminal; the loop says it itself.
        self.library.eltc(0)
        self.asking = threading.Lock()
        """Held from the first get of a request to the end of `ca_pend_io`: libca counts the answers
        of all threads together, and the end of one wait would end the other's, whose answers would
        then be written to memory that nobody keeps any more."""
        self.abandoned: list[object] = []
        """Memory that libca may still write an answer to, after nobody waits for it any more: it
        must outlive whoever asked, and is freed with the context."""
        self.listeners: list[Callable[[ExceptionArguments], None]] = []
        """Called with what libca says beside the calls, on its threads."""
        self._exception_handler = EXCEPTION_HANDLER(self._on_exception)
        handler = ctypes.cast(self._exception_handler, ctypes.c_void_p)
        self.check("ca_add_exception_event", self.library.ca_add_exception_event(handler, None))

    def attach(self) -> None:
        """Make this the context of the calling thread: `flush` and `pend_io` act on it."""
        if self.library.ca_current_context() != self._handle:
            self.library.ca_detach_context()
            self.library.ca_attach_context(self._handle)

    def detach(self) -> None:
        """Leave the calling thread without a context."""
        self.library.ca_detach_context()

    def flush(self) -> None:
        """Send what has been asked for.

        Raises:
            MachineError: libca refused.
        """
        self.check("ca_flush_io", self.library.ca_flush_io())

    def message(self, status: int) -> str:
        """Put a status of libca into words."""
        return self.library.ca_message(status).decode("ascii", "replace")

    def check(self, call: str, status: int) -> None:
        """Turn a status other than success into an error.

        Raises:
            MachineError: The call failed; the message names it.
        """
        if status != ECA_NORMAL:
            raise MachineError(f"{call}: {self.message(status)}")

    def subscribe(
        self,
        name: str,
        handle: ctypes.c_void_p,
        what: tuple[int, int, int],
        handler: Any,
        user: int,
    ) -> int | None:
        """Subscribe to a channel; gives the handle of the subscription.

        Args:
            name: Of the PV.
            handle: Of its channel.
            what: Type and count of the values (0: all), and the kinds of events.
            handler: Must live as long as the context.
            user: Handed to it.

        Raises:
            MachineError: libca refused.
        """
        (kind, count, mask), event = what, ctypes.c_void_p()
        address = ctypes.cast(handler, ctypes.c_void_p)
        status = self.library.ca_create_subscription(
            kind, count, handle, mask, address, user, ctypes.byref(event)
        )
        self.check(f"subscribing to {name}", status)
        return event.value

    def host_of(self, channel: int | None) -> str:
        """Say which server a channel is connected to, `host:port`."""
        text = ctypes.create_string_buffer(_LONGEST_HOST)
        self.library.ca_get_host_name(channel, text, _LONGEST_HOST)
        return text.value.decode("ascii", "replace")

    def _on_exception(self, arguments: ExceptionArguments) -> None:
        for listener in self.listeners:
            listener(arguments)

    def destroy(self) -> None:
        """End the context: its channels, subscriptions and threads.

        libca waits for ever for a name server that does not answer. Where there are any the wait is
        bounded; what does not end by then ends with the process.
        """
        if self.pva is not None:
            self.pva.close()
        if not self._has_name_servers:
            self._end()
            return
        self.detach()
        ending = threading.Thread(target=self._end, name="epics-end", daemon=True)
        ending.start()
        ending.join(END_TIMEOUT)

    def _end(self) -> None:
        self.attach()
        self.library.ca_context_destroy()
