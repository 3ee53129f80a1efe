"""The RF column beside the response: a ring whose dispersion is not what the table says."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import LoopState
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings
from orbitfb.estimation.columns import KnownRf
from orbitfb.history.buffer import History
from orbitfb.loop.frequency import Follower
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.models.identify import Identifier
from orbitfb.models.rows import Rows, select_rows
from orbitfb.models.settings import IdentifySettings
from orbitfb.physics.frequency import frequency_model, frequency_response
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.physics.response import response
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.safety.rf_settings import RfSettings

TOLD = Ring.load()
MODEL = frequency_model(TOLD, "x")
KNOWN = KnownRf(MODEL.response, MODEL.energy / MODEL.per_hertz)
WRONG = 1.1
TRUE = replace(TOLD, table=replace(TOLD.table, dispersion=WRONG * TOLD.table.dispersion))
TRUTH, NOMINAL = response(TRUE, "x"), response(TOLD, "x")
TICKS, NOISE = 1800, 0.2e-6


def recorded(follows: bool):
    """What a loop that knows the table records on the ring that is not so, under an energy ramp."""
    ramp = EffectSettings.model_validate({"id": "energy-ramp", "values": {"rate": 8e-7}})
    plant = plant_with(TRUE, "x", PlantSettings(initial_orbit_rms=0.0), 1, (ramp,), 0.1)
    clock = ManualClock()
    machine = PlantMachine(plant, clock)
    history = History(machine.channels, TICKS)
    runner = Runner(
        machine,
        PolicySlot(SvdPolicy(NOMINAL, SvdSettings())),
        LoopSettings(),
        LimitSettings(),
        InterlockSettings(answer_question=0.0),
        np.zeros(len(NOMINAL)),
        clock,
        start=LoopState.CLOSED,
        subscribers=(history,),
        follower=Follower(machine.oscillator, MODEL, RfSettings(), NOISE, 1.0) if follows else None,
    )
    for _ in range(TICKS):
        runner.step()
    return history.snapshot()


@pytest.fixture(scope="module")
def rows() -> Rows:
    found = select_rows(recorded(True), 0.05, with_rf=True)
    assert np.count_nonzero(found.hertz) > 100
    return found


def model_of(rows: Rows, first=NOMINAL, rf: KnownRf | None = KNOWN):
    identifier = Identifier(first, IdentifySettings(), rf)
    identifier.absorb(rows)
    return identifier.model


def miss(found) -> float:
    return float(np.linalg.norm(found - TRUTH) / np.linalg.norm(TRUTH))


@pytest.mark.parametrize(
    "first", [pytest.param(NOMINAL, marks=pytest.mark.nightly), TRUTH], ids=["table", "measured"]
)
def test_a_dispersion_that_is_wrong_by_a_tenth_is_found(rows, first):
    """Also where R is known and only the column is not: one cannot be told for the other."""
    found = model_of(rows, first).rf
    assert abs(found.ratio - WRONG) < 2.5 * found.sigma
    assert 0.01 < found.sigma < 0.03  # and 1 is refuted
    truth = frequency_response(TRUE, "x")
    before = np.linalg.norm(MODEL.response - truth)
    assert np.linalg.norm(found.response - truth) < before


@pytest.mark.nightly
def test_the_response_is_no_worse_than_without_steps(rows):
    still = select_rows(recorded(False), 0.05)
    alone = miss(model_of(still, rf=None).response)
    assert miss(model_of(rows).response) < 1.05 * alone
    left_out = rows.hertz == 0.0
    holes = replace(rows, hertz=None)
    for index in np.flatnonzero(~left_out)[::-1]:
        holes = holes.without(int(index))
    assert miss(model_of(holes, rf=None).response) > 1.3 * alone


@pytest.mark.nightly
def test_without_the_steps_the_noise_is_taken_for_more_than_it_is(rows):
    """What a step moves has to go somewhere."""
    known, ignored = model_of(rows), model_of(replace(rows, hertz=None), rf=None)
    assert np.mean(ignored.ground_variances) > 1.5 * np.mean(known.ground_variances)


def test_steps_that_are_not_told_teach_nothing_of_the_column(rows):
    found = model_of(replace(rows, hertz=np.zeros(len(rows)))).rf
    assert found.ratio == pytest.approx(1.0, abs=1e-9)
    assert found.sigma == pytest.approx(IdentifySettings().rf_error, rel=0.02)


def test_a_known_table_and_many_steps_give_the_exact_posterior():
    """Against the normal equations of all places at once, κ marginalised in them."""
    generator = np.random.default_rng(4)
    n, m, count = 7, 5, 400
    matrix = 1e-3 * generator.standard_normal((n, m))
    told = 1e-6 * (1.0 + 0.3 * generator.standard_normal(n))
    truth = 1.3 * told + 0.1e-6 * generator.standard_normal(n)
    hertz = generator.standard_normal((count // 50, 50))
    hertz = (hertz - hertz.mean(axis=1, keepdims=True)).ravel()  # no energy drifts
    changes = 1e-4 * generator.standard_normal((count, m))
    walk = 0.04e-6 * generator.standard_normal((count, n))
    noise = NOISE * generator.standard_normal((count + 1, n))
    moved = changes @ matrix.T + np.outer(hertz, truth) + walk + np.diff(noise, axis=0)
    yes = np.ones(count, dtype=bool)
    begins = np.arange(count) == 0
    rows = Rows(
        tick=np.arange(count),
        change=changes,
        dither=np.zeros_like(changes),
        difference=moved,
        valid=np.ones_like(moved, dtype=bool),
        starts=begins,
        closed=yes,
        left_out={},
        hertz=hertz,
    )
    still = IdentifySettings(
        prior_entry=1e-9, drift_entry=0.0, drift_relative=0.0, prior_relative=1e-9
    )
    identifier = Identifier(matrix, still, KnownRf(told, np.zeros(m)))
    identifier.absorb(rows)
    model, found = identifier.model, identifier.model.rf
    size, error = np.mean(told**2), still.rf_error
    prior = error**2 * (np.outer(told, told) + size * np.eye(n))
    reading = model.reading_variance
    shift = np.eye(count, k=1) + np.eye(count, k=-1)
    moved = moved - moved.mean(axis=0)  # a drift of the energy that nobody knows
    changes = changes - changes.mean(axis=0)
    pulled, known = np.zeros(n), np.zeros((n, n))
    for mode, ground in zip(model.modes.T, model.ground_variances, strict=True):
        cover = (2.0 * reading + ground) * np.eye(count) - reading * shift
        left = (moved - changes @ matrix.T) @ mode
        precision = np.linalg.inv(cover)
        known += hertz @ precision @ hertz * np.outer(mode, mode)
        pulled += mode * (hertz @ precision @ left)
    cover = np.linalg.inv(np.linalg.inv(prior) + known)
    wanted = told + cover @ (pulled - known @ told)
    slope = told / (told @ told)
    sigma = np.sqrt(slope @ cover @ slope)
    assert found.ratio == pytest.approx(slope @ wanted, abs=0.3 * sigma)
    assert found.sigma == pytest.approx(sigma, rel=0.1)
    np.testing.assert_allclose(found.response, wanted, atol=0.3 * np.sqrt(np.diag(cover)).max())


def test_a_column_that_does_not_fit_is_refused():
    for column in (MODEL.response[1:], 0.0 * MODEL.response, np.nan * MODEL.response):
        with pytest.raises(EstimationError, match="an RF column of shape"):
            Identifier(NOMINAL, IdentifySettings(), replace(KNOWN, response=column))
