"""What a workspace says of fields, each for itself and all together."""

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import DeviceLaw
from orbitfb.effects.registry import effect
from tests.unit.hypotheses.small_records import kinds_for, make_record


def test_fields_weighed_each_for_itself_have_what_they_have_among_others() -> None:
    record = make_record(71)
    scorer = Scorer.of(Workspace.of(record, kinds_for(record)))
    assert len(scorer.priors.used)
    rng, response = np.random.default_rng(1), record.layout.response
    courses = np.cumsum(rng.standard_normal((len(record), 2 * 5)), axis=0)
    spectrum = scorer.space.transform.quick_spectrum(courses)
    pull, information = scorer.each(response[:, :2], spectrum)
    patterns = [np.repeat(response[:, [place]], 5, axis=1) for place in range(2)]
    by_pattern = spectrum.reshape(-1, 5, 2).swapaxes(1, 2).reshape(-1, 10)
    together, whole = scorer.columns(patterns, by_pattern)
    np.testing.assert_allclose(pull, together, rtol=1e-4)
    np.testing.assert_allclose(information, np.diag(whole), rtol=1e-4)
    again, several = scorer.columns([response[:, :1], response[:, 1:2]], spectrum)
    np.testing.assert_allclose(again, together, rtol=1e-4)
    np.testing.assert_allclose(several, whole, rtol=1e-3, atol=1e-4 * whole.max())


def test_what_a_law_of_all_devices_shows_is_what_its_field_does() -> None:
    """Against the sum over all frequencies of what all of them add together."""
    record = make_record(33)
    kind, space = effect("corrector-lag"), Workspace.of(record, kinds_for(record))
    (law,), scorer = space.courses.laws(kind), Scorer.of(space)
    assert isinstance(law, DeviceLaw)
    values = space.courses.grid(kind)[3]
    together, _ = scorer.together(law.patterns[0], space.courses.spectra(law, values)[0], ())
    (course,) = law.course(values, space.signals)
    field = space.transform.spectrum(course) @ law.patterns[0].T
    exact = float(np.sum(field * space.noise.pull(field, space.transform)))
    assert together == pytest.approx(exact, rel=0.2)
