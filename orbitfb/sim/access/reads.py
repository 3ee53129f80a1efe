"""Reads picked straight out of a client's stream of bytes, and their answers.

A read of one double is a bare header of 16 bytes: command 15, no payload, type 6, count 0 (as
many as there are) or 1, channel, request id. A controller that is in doubt asks for all setpoints
at once; object by object that would keep the ring waiting for longer than a tick at 100 Hz.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector

READ_COMMAND = 15
READ = np.dtype(
    [
        ("kind", ">u8"),  # command, payload size, type and count
        ("channel", ">u4"),
        ("request", ">u4"),
    ]
)
ANSWER = np.dtype([("kind", ">u8"), ("status", ">u4"), ("request", ">u4"), ("value", ">f8")])
_READ_KINDS = tuple(READ_COMMAND << 48 | 6 << 16 | count for count in (0, 1))
_ANSWER_KIND = READ_COMMAND << 48 | 8 << 32 | 6 << 16 | 1
_NORMAL = 1


def leading_reads(data: bytes, start: int) -> NDArray[np.void]:
    """Give the unbroken run of whole reads that begins at `start`; it may be empty."""
    run = np.frombuffer(data, dtype=READ, count=(len(data) - start) // READ.itemsize, offset=start)
    other = (run["kind"] != _READ_KINDS[0]) & (run["kind"] != _READ_KINDS[1])
    return run[: int(other.argmax())] if other.any() else run


def answers(requests: NDArray[np.uint32], values: Vector) -> bytes:
    """Write the answers to some reads.

    Args:
        requests: What the client calls them, shape (k,).
        values: Shape (k,), in the unit of the PVs.
    """
    block = np.empty(len(values), dtype=ANSWER)
    block["kind"], block["status"] = _ANSWER_KIND, _NORMAL
    block["request"], block["value"] = requests, values
    return block.tobytes()
