"""Records of one machine that are looked at together have the same BPMs left."""

from dataclasses import replace

import numpy as np
from gap_cases import record

from orbitfb.diagnose.certain import beside, with_bpms
from orbitfb.effects.registry import effect
from orbitfb.records.gaps import gaps_of


def test_another_record_is_cut_to_the_bpms_that_are_left():
    whole = record(False)
    keep = np.array([i for i in range(len(whole.layout.bpms)) if i != 7])
    less = with_bpms(whole, keep)
    cut = beside(record(False, seed=6), less)
    assert cut.layout.bpms == less.layout.bpms
    assert cut.readings.shape == less.readings.shape
    assert beside(whole, whole) is whole


def test_gaps_of_another_record_keep_their_number():
    its, rows = record(False), len(record(False))
    gaps = {name: np.linspace(0.02, 0.01, rows) for name in ("gap 1", "gap 2", "gap 3")}
    mine = replace(its, auxiliary=gaps)
    theirs = {"gap 0": gaps["gap 1"], "gap 2": gaps["gap 2"], "current": gaps["gap 3"]}
    other = replace(its, auxiliary=theirs)
    cut = beside(other, mine)
    assert list(gaps_of(cut)) == list(gaps)
    assert np.ptp(cut.auxiliary["gap 1"]) == 0.0
    assert cut.auxiliary["gap 2"] is gaps["gap 2"]
    assert "current" in cut.auxiliary
    kind = effect("insertion-device")
    assert kind.follows({"gap": 1}, mine) == ("gap 2",)
