"""Records of one machine that are looked at together have the same BPMs left."""

import numpy as np
from gap_cases import record

from orbitfb.diagnose.certain import beside, with_bpms


def test_another_record_is_cut_to_the_bpms_that_are_left():
    whole = record(False)
    keep = np.array([i for i in range(len(whole.layout.bpms)) if i != 7])
    less = with_bpms(whole, keep)
    cut = beside(record(False, seed=6), less)
    assert cut.layout.bpms == less.layout.bpms
    assert cut.readings.shape == less.readings.shape
    assert beside(whole, whole) is whole
