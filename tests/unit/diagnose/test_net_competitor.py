"""The forward net is brought to a record as the model that it is, and is not believed blindly."""

from types import SimpleNamespace

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench, record

from orbitfb.diagnose.net_competitor import NetCompetitor, _trusted, fitted_net
from orbitfb.diagnose.replay import Model, Replay
from orbitfb.diagnose.shrink import contrast, k_steps, shrink


def knowing(change):
    """A net that says that the response is another one."""
    response = record(True).layout.response
    return SimpleNamespace(
        response=response, difference=lambda orbit, moved: moved @ (response + change).T
    )


@pytest.fixture(scope="module")
def change():
    its = np.zeros_like(record(True).layout.response)
    its[:, PLACE] = GAIN * record(True).layout.response[:, PLACE]
    return its


def test_a_net_that_knows_the_change_is_the_model_with_the_change(change):
    replay = Replay.of(bench(True))
    orbit = NetCompetitor(knowing(change)).extra(replay)
    for steps in (1, 5):
        errors = replay.errors(Model(orbit=orbit), steps)
        assert errors == pytest.approx(replay.errors(Model(change=change), steps), abs=1e-15)


def test_a_right_net_takes_the_gap_away_and_changes_no_other_figure(change):
    its, later = bench(True, ((PLACE, GAIN),)), record(True, seed=6)
    without = shrink(contrast(its, later))
    both = contrast(its, later, net=NetCompetitor(knowing(change)))
    found = shrink(both)
    assert found.net_um > 0.9
    assert found.model_copy(update={"net_um": None}) == without
    assert all(step.net_um < 0.25 * step.nominal_um for step in k_steps(both))


def test_a_right_net_is_believed_and_an_opposite_one_is_not(change):
    replay = Replay.of(bench(True, ((PLACE, GAIN),)))
    assert _trusted(NetCompetitor(knowing(change)), replay, 300).trust > 0.8
    assert _trusted(NetCompetitor(knowing(-change)), replay, 300).trust == 0.0


def test_a_short_record_has_no_net_and_says_why():
    net = fitted_net(bench(True))
    assert net.net is None
    assert "600 needed" in net.note
    compared = contrast(bench(True, ((PLACE, GAIN),)), record(True, seed=6), net=net)
    found = shrink(compared, net_note=net.note)
    assert found.net_um is None
    assert found.net_note == net.note
