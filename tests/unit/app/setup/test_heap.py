"""Memory that is freed goes back to the system."""

import subprocess
import sys

import pytest

PROGRAM = """
import sys
import numpy as np, psutil
from orbitfb.app.setup.heap import give_large_blocks_back
told = not {told} or give_large_blocks_back()
np.ones(4_000_000)  # freed at once: 32 MB, up to which blocks are hoarded from now on
blocks = [np.ones(40_000) for _ in range(200)]  # 64 MB
kept = blocks[::2]
full = psutil.Process().memory_info().rss
del blocks
print(told, (full - psutil.Process().memory_info().rss) >> 20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of the C library of GNU")
@pytest.mark.parametrize("told", [True, False])
def test_what_lies_between_blocks_that_are_kept_is_given_back(told):
    words = [sys.executable, "-c", PROGRAM.format(told=told)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    could, freed = done.stdout.split()
    assert could == "True"
    assert (int(freed) > 20) is told
