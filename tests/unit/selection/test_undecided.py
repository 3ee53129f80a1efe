"""Whether what was not read may say which the next cause is."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.corrected import drawn_apart
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.undecided import undecided
from tests.unit.hypotheses.small_records import kinds_for, make_record


def test_a_rival_is_weighed_again_only_if_what_was_not_read_may_lift_it_to_the_best() -> None:
    record = make_record(21, lambda currents: 1.3 * currents, dither=0.2)
    filled = np.zeros(record.readings.shape, dtype=np.bool_)
    filled[400:420, 3] = True
    record = replace(record, filled=filled)
    space = Workspace.of(record, kinds_for(record))
    one = candidates_of(space, kinds_for(record))[0]
    assert one.field is not None
    more = drawn_apart(space, one.field)
    best = replace(one, evidence=max(one.evidence, 3.0 * more))
    near = replace(one, evidence=best.evidence - 0.9 * more)
    far = replace(one, evidence=best.evidence - 1.1 * more)

    assert more > 20.0
    assert undecided([best, near, far], space) == [best, near]
    assert undecided([best, far], space) == [best]
    assert undecided([best, near], Workspace.of(make_record(21), kinds_for(record))) == []
