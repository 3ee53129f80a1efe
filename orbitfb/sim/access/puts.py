"""Setpoints picked straight out of a client's stream of bytes.

A write of one double without answer is a message of 24 bytes: command 4, payload size 8, type 6,
count 1, channel, request id, value. A controller sends a whole set of them at once; here they are
read as one array.
"""

import numpy as np
from caproto import RemoteProtocolError
from numpy.typing import NDArray

from orbitfb.core.signals import Vector

PUT = np.dtype(
    [
        ("kind", ">u8"),  # command, payload size, type and count
        ("channel", ">u4"),
        ("request", ">u4"),
        ("value", ">f8"),
    ]
)
PUT_COMMAND = 4
PUT_KIND = PUT_COMMAND << 48 | 8 << 32 | 6 << 16 | 1
DOUBLE = 6
WRITES = frozenset({4, 19})
"""Commands that write: without and with an answer."""
LARGEST_MESSAGE = 1 << 20
"""What no client of scalars ever sends [bytes]."""
_HEADER, _EXTENDED_HEADER = 16, 24


def leading_puts(data: bytes, start: int) -> NDArray[np.void]:
    """Give the unbroken run of whole puts that begins at `start`; it may be empty."""
    run = np.frombuffer(data, dtype=PUT, count=(len(data) - start) // PUT.itemsize, offset=start)
    other = run["kind"] != PUT_KIND
    return run[: int(other.argmax())] if other.any() else run


def array_put(data: bytes, start: int, end: int) -> tuple[int, Vector] | None:
    """Give channel and values of a put of doubles, or None if it is another one.

    Args:
        data: Bytes of a client.
        start: Where its message begins.
        end: Where it ends.
    """
    size, kind, count = (int.from_bytes(data[start + at : start + at + 2]) for at in (2, 4, 6))
    if kind != DOUBLE or size != 8 * count or end - start != _HEADER + size:
        return None
    channel = int.from_bytes(data[start + 8 : start + 12])
    values = np.frombuffer(data, dtype=">f8", count=count, offset=start + _HEADER)
    return channel, values.astype(np.float64)


def message_end(data: bytes, start: int) -> int | None:
    """Say where the message at `start` ends, or None if it is not all there.

    Raises:
        RemoteProtocolError: It is longer than anything a client of scalars sends.
    """
    if len(data) - start < _HEADER:
        return None
    size = int.from_bytes(data[start + 2 : start + 4])
    header = _HEADER
    if size == 0xFFFF:
        if len(data) - start < _EXTENDED_HEADER:
            return None
        header = _EXTENDED_HEADER
        size = int.from_bytes(data[start + 16 : start + 20])
    if size > LARGEST_MESSAGE:
        raise RemoteProtocolError(f"message of {size} bytes announced; at most {LARGEST_MESSAGE}")
    end = start + header + size
    return end if end <= len(data) else None
