"""What the program frees goes back to the system at once."""

import ctypes
import sys

LARGE = 128 << 10
"""Size of a block from which the C library of GNU takes it from the system and gives it back when
it is freed [bytes]: its own at the start. By itself it raises that up to 32 MB, whenever such a
block is freed; what the learner frees then stays, in pieces, and memory grows for hours."""
_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of <malloc.h>


def give_large_blocks_back() -> bool:
    """Keep the C library from hoarding; say whether it could be told to, as GNU's can."""
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and mallopt(_MMAP_THRESHOLD, LARGE) == 1
