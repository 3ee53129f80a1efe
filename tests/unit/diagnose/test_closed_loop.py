"""The simulated loop has the orbit that was measured, with the right cause."""

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench, record

from orbitfb.diagnose.closed_loop import closed_loop, mended_response
from orbitfb.diagnose.loop_law import linear_law
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def test_the_law_is_found():
    its = record(False)
    law, follows = linear_law(its)
    policy = SvdPolicy(its.layout.response, SvdSettings(gain=0.35, regularisation=70e-6))
    assert follows > 0.999
    assert law == pytest.approx(policy.gain_matrix, abs=1e-3 * np.abs(policy.gain_matrix).max())


def test_the_measured_rms_is_predicted():
    its = closed_loop(bench(True, ((PLACE, GAIN),)))
    assert its.measured_low <= its.measured_um <= its.measured_high
    assert its.with_um == pytest.approx(its.measured_um, rel=0.05)
    assert its.radius_with < 1.0


def test_a_gain_error_changes_one_column():
    its = bench(True, ((PLACE, GAIN),))
    nominal = its.record.layout.response
    mended = mended_response(its.record, its.causes)
    assert mended[:, PLACE] == pytest.approx(nominal[:, PLACE] * (1 + GAIN))
    assert np.delete(mended, PLACE, 1) == pytest.approx(np.delete(nominal, PLACE, 1))
