"""The RF frequency follows an energy that drifts: the whole loop on a simulated ring in process."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import RingError, WriteError
from orbitfb.core.signals import LoopState
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings
from orbitfb.estimation.columns import KnownRf
from orbitfb.loop.frequency import Follower
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.frequency import frequency_model, undoing
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.physics.response import response
from orbitfb.policies.rf_known import with_rf
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.safety.rf_settings import RfSettings

RING = Ring.load()
RESPONSE = response(RING, "x")
MODEL = frequency_model(RING, "x")
RATE, NOISE = 8e-7, 0.2e-6
M = RESPONSE.shape[1]


class Bench:
    """A closed loop under an energy ramp, on virtual time."""

    def __init__(self, model=MODEL, settings=None, follows=True, period=0.1, rf=None) -> None:
        ramp = EffectSettings.model_validate({"id": "energy-ramp", "values": {"rate": RATE}})
        plant = plant_with(RING, "x", PlantSettings(initial_orbit_rms=0.0), 1, (ramp,), period)
        clock, self.period = ManualClock(), period
        self.machine = PlantMachine(plant, clock, period)
        self.oscillator = self.machine.oscillator
        its = settings or RfSettings()
        self.follower = Follower(self.oscillator, model, its, NOISE, 1.0) if follows else None
        self.runner = Runner(
            self.machine,
            PolicySlot(with_rf(SvdPolicy(RESPONSE, SvdSettings()), rf)),
            LoopSettings(rate_hz=1.0 / period),
            LimitSettings(),
            InterlockSettings(answer_question=0.0),  # whose questions are drawn without a seed
            np.zeros(len(RESPONSE)),
            clock,
            start=LoopState.CLOSED,
            follower=self.follower,
        )
        self.energies, self.steps, self.true = [], [], []

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            record = self.runner.step()
            moved = self.oscillator.frequency - RING.rf_frequency
            drifted = RATE * self.period * self.machine.plant.tick
            energy = float(MODEL.energy @ (record.setpoints + record.applied))
            self.energies.append(energy + MODEL.per_hertz * moved + drifted)
            self.steps.append(record.reading.auxiliary.get("rf_step", 0.0))
            self.true.append(self.machine.true_orbit_rms)


def test_the_energy_stays_and_the_orbit_with_it():
    alone, follows = Bench(follows=False), Bench()
    alone.run(500)
    follows.run(500)
    assert alone.energies[-1] < -3e-5
    assert np.abs(follows.energies).max() < 5e-6
    currents = follows.machine.setpoints()
    assert np.sqrt(np.mean(currents**2)) < 0.01
    assert np.count_nonzero(follows.steps) > 10 and np.abs(follows.steps).max() <= 1.0
    assert np.mean(np.square(follows.true)) < 1.03**2 * np.mean(np.square(alone.true))
    assert follows.runner.state is LoopState.CLOSED


def test_at_one_orbit_a_second_what_drifts_meanwhile_is_no_answer():
    """The energy moves further from orbit to orbit than by the first steps of the frequency."""
    bench = Bench(period=1.0)
    bench.run(100)
    assert bench.follower.sight.following, bench.follower.sight.reason
    assert np.abs(bench.energies[40:]).max() < 5e-6


def test_by_command_it_is_left_alone_and_follows_from_there_again():
    bench = Bench()
    bench.run(100)
    bench.follower.wanted = False
    before = bench.oscillator.frequency
    bench.run(100)
    assert bench.oscillator.frequency == before
    assert bench.follower.sight.reason == "off by command"
    bench.follower.wanted = True
    bench.run(100)
    assert bench.oscillator.frequency != before and bench.follower.sight.following


def test_a_dispersion_of_the_wrong_sign_is_told_before_anything_moves():
    table = replace(RING.table, dispersion=-RING.table.dispersion)
    with pytest.raises(RingError, match="they have the same sign in every ring"):
        frequency_model(replace(RING, table=table), "x")
    with pytest.raises(RingError, match="no dispersion"):
        frequency_model(replace(RING, table=replace(table, dispersion=0 * table.s)), "x")
    with pytest.raises(RingError, match="plane x alone"):
        frequency_model(RING, "y")


@pytest.mark.parametrize("sign", [-1.0, 0.0])
def test_an_rf_that_turns_the_other_way_or_does_nothing_is_let_go_after_three_small_steps(sign):
    bench = Bench()
    start, put = bench.oscillator.frequency, bench.oscillator.put
    seen = [start]
    plant, step = bench.machine.plant, bench.machine.plant.step
    plant.step = lambda setpoints, change: step(setpoints, sign * change)
    bench.oscillator.put = lambda frequency: (seen.append(frequency), put(frequency))
    bench.run(300)
    assert "does not answer the RF" in bench.follower.sight.reason
    assert len(seen) == 1 + 3 and abs(seen[-1] - start) < 0.5
    assert bench.runner.state is LoopState.CLOSED


def test_somebody_else_may_set_the_frequency_and_has_it_then():
    bench = Bench()
    bench.run(100)
    bench.oscillator.frequency += 1.0
    bench.run(50)
    assert "somebody else sets" in bench.follower.sight.reason
    theirs = bench.oscillator.frequency
    bench.run(100)
    assert bench.oscillator.frequency == theirs and not bench.follower.sight.following
    bench.follower.again()
    bench.run(100)
    assert bench.follower.sight.following


def test_a_put_that_fails_is_told_and_tried_again():
    bench = Bench()
    put = bench.oscillator.put

    def away(_frequency: float) -> None:
        raise WriteError("the RF is away")

    bench.oscillator.put = away
    bench.run(100)
    assert not any(bench.steps)
    assert bench.runner.state is LoopState.CLOSED
    bench.oscillator.put = put
    bench.run(100)
    assert any(bench.steps)


def test_a_row_carries_the_step_that_went_with_its_change():
    from orbitfb.history.buffer import History
    from orbitfb.models.rows import select_rows

    bench = Bench()
    history = History(bench.machine.channels, 500)
    bench.runner.subscribe(history)
    bench.run(300)
    rows = history.snapshot()
    steps = np.array(bench.steps)[rows.tick + 1]
    assert np.count_nonzero(steps) > 3
    np.testing.assert_array_equal(rows.hertz, steps)
    assert rows.usable.mean() > 0.95 and not rows.by_correctors().usable[steps != 0.0].any()
    without, with_rf = select_rows(rows, 1e-3), select_rows(rows, 1e-3, with_rf=True)
    assert without.left_out == {"unusable": np.count_nonzero(steps)} and without.hertz is None
    assert not with_rf.left_out and np.count_nonzero(with_rf.hertz) == np.count_nonzero(steps)


def test_rows_in_which_somebody_else_moved_the_frequency_do_not_teach():
    from orbitfb.history.buffer import History
    from orbitfb.models.rows import select_rows

    bench = Bench()
    history = History(bench.machine.channels, 500)
    bench.runner.subscribe(history)
    bench.run(100)
    bench.oscillator.frequency += 1.0
    bench.run(50)
    rows = select_rows(history.snapshot(), 1e-3, with_rf=True)
    assert rows.left_out == {"foreign_rf": 1}


def known(size: float) -> KnownRf:
    return KnownRf(size * MODEL.response, MODEL.energy / MODEL.per_hertz, identified=True)


def test_what_goes_with_a_step_is_by_the_column_of_the_policy_in_force():
    table, learnt = Bench(), Bench(rf=known(1.2))
    for bench in (table, learnt):
        bench.run(60)
    assert table.follower.sight.ratio == 1.0
    assert learnt.follower.sight.ratio == pytest.approx(1.2)
    mine, theirs = (its.follower._pattern[2] for its in (learnt, table))
    np.testing.assert_allclose(mine.change, 1.2 * theirs.change)
    learnt.run(300)
    assert learnt.follower.sight.following
    assert np.abs(learnt.energies).max() < 5e-6


@pytest.mark.parametrize("size", [-1.0, 0.3, 1.7])
def test_a_policy_whose_column_the_table_contradicts_is_not_followed(size):
    bench = Bench(rf=known(size))
    start = bench.oscillator.frequency
    bench.run(100)
    assert "the RF column of the policy in force is not used" in bench.follower.sight.reason
    assert bench.oscillator.frequency == start


def test_a_law_that_learns_the_rf_is_told_of_steps_and_any_other_one_is_not():
    heard: dict[str, list] = {"rf": [], "deaf": []}

    class Pupil(SvdPolicy):
        learns_rf = False

        def inform(self, error, valid, applied, state, **more):
            heard["rf" if self.learns_rf else "deaf"].append((applied, more))
            return state

    class Wise(Pupil):
        learns_rf = True

    for kind in (Pupil, Wise):
        bench = Bench()
        bench.runner._engine._guard._slot.swap(kind(RESPONSE, SvdSettings()))
        bench.run(200)
        told = heard["rf" if kind is Wise else "deaf"][:-1]  # of the last one nothing is seen yet
        steps = np.array(bench.steps)[-len(told) :]
        assert np.count_nonzero(steps) > 3
        hertz = np.array([more.get("hertz", 0.0) for _, more in told])
        np.testing.assert_array_equal(hertz, steps if kind is Wise else 0.0 * steps)
        moved = np.array([MODEL.energy @ applied for applied, _ in told])[steps != 0.0]
        undone = -MODEL.per_hertz * steps[steps != 0.0]
        share = float(undone @ moved / (undone @ undone))
        assert share > 1.0 if kind is Wise else abs(share) < 0.3


def test_correctors_that_move_undo_the_dispersion_orbit():
    movable = np.ones(M, dtype=bool)
    movable[::7] = False
    change = undoing(RESPONSE, MODEL.response, movable)
    assert not change[~movable].any()
    left = MODEL.response + RESPONSE @ change
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(MODEL.response)


@pytest.mark.parametrize(
    ("track", "size"), [(False, 1.0), pytest.param(True, 1.3, marks=pytest.mark.nightly)]
)
def test_beside_the_law_that_learns_the_frequency_follows(track: bool, size: float):
    """A law that took the drift of the energy for the answer to steps would let it go."""
    from orbitfb.policies.adaptive import AdaptivePolicy
    from orbitfb.policies.adaptive_settings import AdaptiveSettings

    bench = Bench()
    law = AdaptivePolicy(RESPONSE, AdaptiveSettings(track_rf=track))
    bench.runner._engine._guard._slot.swap(with_rf(law, known(size)))
    bench.run(450)
    assert bench.follower.sight.following, bench.follower.sight.reason
    assert np.abs(bench.energies).max() < 5e-6
    if law.known.column is not None:
        found = float(law.known.column @ MODEL.response / (MODEL.response @ MODEL.response))
        assert min(size, 1.0) - 0.05 < found < size + 0.01
