"""What a workspace says of fields, each for itself and all together."""

import numpy as np

from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
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
    together, whole = scorer.columns(patterns, spectrum)
    np.testing.assert_allclose(pull, together, rtol=1e-4)
    np.testing.assert_allclose(information, np.diag(whole), rtol=1e-4)
