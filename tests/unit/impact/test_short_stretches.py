"""Records in many pieces, some of them shorter than what is looked back."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.slices import lag_profile
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from tests.unit.hypotheses.small_records import kinds_for, make_record


def test_the_lag_profile_of_a_record_in_pieces_is_flat() -> None:
    record = make_record(71)
    starts = record.starts.copy()
    starts[[2, 5, 300, 301, 600]] = True
    record = replace(record, starts=starts)
    kinds = kinds_for(record)
    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)
    profile = lag_profile(Explained.of([], accepted, rounds))
    sigma = (np.array(profile.high) - np.array(profile.low)) / (2.0 * 1.645)
    assert np.all(np.abs(profile.slope) < 3.5 * sigma)
