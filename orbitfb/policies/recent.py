"""A few results by mask, shared by the threads that use one policy."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from orbitfb.core.signals import Mask

T = TypeVar("T")

_KEPT = 8


class Recent(Generic[T]):
    """Keeps what was made for the masks that were seen last.

    Two threads that meet a new mask at once may both make its result; either is as good.

    Args:
        make: Makes the result for a mask.
        kept: How many are kept.
    """

    def __init__(self, make: Callable[[Mask], T], kept: int = _KEPT) -> None:
        self._make, self._kept = make, kept
        self._results: OrderedDict[bytes, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, mask: Mask) -> T:
        """Give the result for a mask, making it if it is not among the last ones."""
        key = mask.tobytes()
        with self._lock:
            result = self._results.get(key)
            if result is not None:
                self._results.move_to_end(key)
                return result
        result = self._make(mask)
        with self._lock:
            self._results[key] = result
            while len(self._results) > self._kept:
                self._results.popitem(last=False)
        return result
