"""What is handed on of numpy's words on a file that it cannot read."""

import io
import struct

import numpy as np
import pytest

from orbitfb.core.files.arrays import first_line

LONG = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3,), " + b" " * 19_000 + b"}"
PICKLED = b"hello world"


@pytest.mark.parametrize(
    "content", [b"\x93NUMPY\x02\x00" + struct.pack("<I", len(LONG)) + LONG, PICKLED]
)
def test_nobody_is_advised_to_trust_a_file(content):
    with pytest.raises(ValueError) as caught:
        np.load(io.BytesIO(content), allow_pickle=False)
    assert "allow_pickle" in str(caught.value)
    told = first_line(caught.value)
    assert told and "allow_pickle" not in told and "\n" not in told
