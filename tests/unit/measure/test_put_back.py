"""What a killed measurement left astray is put back, and nothing goes beyond a limit by it."""

import numpy as np
import pytest
from measured_ring import NOMINAL, Bench
from numpy.testing import assert_array_equal

from orbitfb.app.response.unfinished import put_back
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import MeasurementError
from orbitfb.measure.watch import Watch


def restore(bench: Bench, found: float) -> None:
    before = bench.base.copy()
    before[3] = found
    bench.journal.mark([3], before, 1.0)
    watch = Watch(
        bench.machine, bench.settings, bench.interlocks, bench.counting, 0.5, lambda: False
    )
    put_back(bench.machine, NOMINAL, bench.journal, "here", watch, AppConfig(), True, print, None)


def test_it_is_put_back(tmp_path):
    bench = Bench(tmp_path)
    restore(bench, 0.5)
    assert bench.machine.setpoints()[3] == pytest.approx(0.5)
    assert_array_equal(np.delete(bench.machine.setpoints() - bench.base, 3), 0.0)
    assert bench.journal.moved() is None


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (500.0, r"beyond limits\.setpoint .* nothing is moved"),
        (9.0, r"would move the orbit by .* µm rms"),
    ],
)
def test_what_cannot_be_right_moves_nothing(tmp_path, found, words):
    bench = Bench(tmp_path)
    with pytest.raises(MeasurementError, match=words):
        restore(bench, found)
    assert_array_equal(bench.machine.setpoints(), bench.base)
    assert bench.journal.moved() is not None
