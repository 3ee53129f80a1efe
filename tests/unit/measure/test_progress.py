"""How far a measurement is, by its orbits."""

import pytest

from orbitfb.measure.progress import Progress, Stage, progress_of


def test_the_time_left_is_of_the_orbits_that_are_left_at_the_pace_that_was_seen():
    assert progress_of(0, 1000, 0.0, 0.1) == (0.0, pytest.approx(100.0))
    assert progress_of(250, 1000, 50.0, 0.1) == (0.25, pytest.approx(150.0))
    assert progress_of(1100, 1000, 110.0, 0.1) == (1.0, 0.0)  # some were rejected
    assert progress_of(3, 0, 1.0, 0.1) == (0.0, 0.0)  # not planned yet


def test_setpoints_may_be_away_while_it_measures_or_puts_back():
    assert [stage for stage in Stage if Progress(stage).running] == [
        Stage.MEASURING,
        Stage.PUTTING_BACK,
    ]
