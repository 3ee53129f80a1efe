"""Values of every device of a cause."""

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.impact.pieces import pieces_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import DeviceLaw
from orbitfb.effects.registry import effect
from tests.unit.hypotheses.small_records import make_record


def test_the_values_of_a_device_are_ones_that_its_effect_has() -> None:
    """A size that is told by itself may leave them: no more than all of a field has play."""
    kind = effect("corrector-hysteresis")
    space = Workspace.of(make_record(3), [kind])
    (law,) = (one for one in space.courses.laws(kind) if isinstance(one, DeviceLaw))
    own = {"width": np.array([1.0, 2.0])}
    source = Course(law, (2, 5), {"width": 1e-3, "share": 0.8}, np.array([-5.9, 0.5]), own=own)
    part = Candidate(kind, source.places, (), dict(source.values), 100.0, sources=(source,))
    first, second = pieces_of(part, space, np.zeros(len(space.terms)), {})
    assert first.values == {"width": 1e-3, "share": -1.0}
    assert second.values == {"width": 2e-3, "share": 0.4}
