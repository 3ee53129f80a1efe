"""Planned experiments: within their limits, readable by the loop, and they do resolve."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Channels
from orbitfb.diagnose import plan_response
from orbitfb.diagnose.background import Background
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.proposals import proposals
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit, fit
from orbitfb.diagnose.plan import limits_of, plan, plan_for
from orbitfb.diagnose.plan_answer import ENOUGH
from orbitfb.diagnose.plan_outlook import answered, loop_gains, outlook
from orbitfb.diagnose.plan_response import separation
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import all_effects, effect
from orbitfb.effects.sensors.bpm_walk import BpmWalk
from orbitfb.loop.excitation.design import check_excitation
from orbitfb.loop.excitation.file import read_excitation
from orbitfb.physics.places import Ring
from orbitfb.records.record import Record
from orbitfb.safety.limits import LimitSettings

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)


def recorded(
    name: str,
    place: int,
    values: dict[str, float],
    ticks: int,
    steering: int = 4,
    excitation: np.ndarray | None = None,
) -> Record:
    rng = np.random.default_rng(1)
    its = effect(name).simulate(LAYOUT, np.array([place]), values, rng)
    return simulate_record(
        RING, ticks=ticks, seed=3, effects=[its], steering=steering, excitation=excitation
    )


def best(bench: Bench, name: str, place: int, starts: list[dict[str, float]]) -> Fit:
    fits = [fit(bench, (Cause(effect(name), (place,), start),)) for start in starts]
    return max(fits, key=lambda one: one.gain)


@pytest.fixture(scope="module")
def weak() -> tuple[Bench, Plan]:
    bench = Bench(recorded("corrector-gain", 50, {"gain": 0.08}, 250))
    return bench, plan(bench, Cause(effect("corrector-gain"), (50,), {"gain": 0.08}))


def test_a_weak_gain_that_a_passive_record_hides_is_seen_after_the_plan(
    weak: tuple[Bench, Plan],
) -> None:
    bench, its = weak
    hidden = best(bench, "corrector-gain", 50, [{"gain": 0.08}])
    rows = its.waveform().excursion
    after = Bench(recorded("corrector-gain", 50, {"gain": 0.08}, 250 + len(rows), excitation=rows))
    seen = best(after, "corrector-gain", 50, [{"gain": 0.08}])
    assert its.experiment.text.startswith("To see corrector-gain of 0.08 better: ")
    assert hidden.gain < 0.5 * ENOUGH
    assert seen.gain > hidden.gain + 0.5 * ENOUGH
    assert seen.causes[0].values["gain"] == pytest.approx(0.08, abs=0.02)


def test_a_plan_splits_gain_from_nonlinearity_that_one_orbit_cannot() -> None:
    bent = [{"quadratic": 200.0, "cubic": 1.0}, {"quadratic": 5000.0, "cubic": 1e6}]
    bench = Bench(recorded("bpm-gain", 40, {"gain": 0.1}, 300, steering=1))
    gain = best(bench, "bpm-gain", 40, [{"gain": 0.1}])
    curve = best(bench, "bpm-nonlinearity", 40, bent)
    assert abs(gain.gain - curve.gain) < 5.0  # the record cannot tell
    its = plan(bench, gain.causes[0], [curve.causes[0]])
    assert its.experiment.kind == "bump-ladder"
    rows = its.waveform().excursion
    after = Bench(
        recorded("bpm-gain", 40, {"gain": 0.1}, 300 + len(rows), steering=1, excitation=rows)
    )
    starts = [*bent, dict(curve.causes[0].values)]
    margin = (
        best(after, "bpm-gain", 40, [{"gain": 0.1}]).gain
        - best(after, "bpm-nonlinearity", 40, starts).gain
    )
    assert margin > 0.5 * ENOUGH


def test_a_plan_keeps_its_limits(weak: tuple[Bench, Plan]) -> None:
    bench, _ = weak
    layout = bench.record.layout
    cause = Cause(effect("corrector-gain"), (50,), {"gain": 0.03})
    write = LimitSettings(change_per_tick=0.05)
    its = plan(bench, cause, (), limits_of(2e-6, 3.0, write))
    rows = its.waveform().excursion
    channels = Channels("x", layout.bpms.names, layout.correctors.names, (), (), ())
    everything = np.ones(rows.shape[1], dtype=bool)
    check_excitation(its.waveform(), channels, layout.response, write, 1e-3, everything)
    orbit = np.sqrt(np.mean((rows @ layout.response.T) ** 2, axis=1))
    assert orbit.max() <= 2e-6 * 1.001
    assert its.experiment.orbit_cost_um == pytest.approx(orbit.max() * 1e6, rel=0.01)
    assert len(rows) * layout.period <= 180.5


@pytest.mark.parametrize("name", ["excite.toml", "excite.npz"])
def test_the_loop_reads_what_was_planned(
    weak: tuple[Bench, Plan], tmp_path: Path, name: str
) -> None:
    bench, its = weak
    layout = bench.record.layout
    its.write(tmp_path / name)
    channels = Channels("x", layout.bpms.names, layout.correctors.names, (), (), ())
    read = read_excitation(tmp_path / name, channels, layout.response, layout.period)
    assert np.allclose(read.excursion, its.waveform().excursion, atol=1e-7)
    assert read.wait == its.waveform().wait
    if name.endswith("toml"):
        assert tomllib.loads((tmp_path / name).read_text())["part"]


def test_what_no_corrector_can_split_is_said_in_words(weak: tuple[Bench, Plan]) -> None:
    bench, _ = weak
    missed = Cause(effect("missed-write"), (), {"probability": 0.01})
    jitter = Cause(effect("clock-jitter"), (), {"rms": 0.01})
    its = plan(bench, missed, [jitter])
    assert its.settings is None
    assert "time stamps" in its.experiment.text
    assert "helps to tell missed-write from clock-jitter. Beyond the limits, or without" in (
        its.experiment.text
    )
    with pytest.raises(EstimationError, match="nothing to run"):
        its.waveform()


def test_a_plan_splits_all_rivals_and_says_which_it_cannot(weak: tuple[Bench, Plan]) -> None:
    bench, alone = weak
    gain = Cause(effect("corrector-gain"), (50,), {"gain": 0.08})
    near = Cause(effect("corrector-gain"), (51,), {"gain": 0.08})
    lag = Cause(effect("corrector-lag"), (50,), {"tau": 0.02})
    noise = Cause(effect("noise-level"), (20,), {"factor": 1.5})
    its = plan(bench, gain, [near, lag, noise]).experiment
    pair = plan(bench, gain, [near]).experiment
    assert its.splits == ("corrector-gain", "corrector-gain", "corrector-lag")
    assert "corrector-gain and corrector-lag:" in its.text
    assert "does not split corrector-gain from noise-level: " in its.text
    assert its.separation_nats is not None and its.separation_nats >= ENOUGH
    assert pair.minutes is not None and its.minutes is not None and alone.experiment.minutes
    assert its.minutes * (its.orbit_cost_um or 1e-9) >= pair.minutes * (pair.orbit_cost_um or 1e-9)


def test_noise_of_a_group_is_planned_for_at_the_bpms_of_the_group() -> None:
    walk = BpmWalk()
    patterns = walk.patterns(LAYOUT)
    group = patterns.shape[1] - 2  # a cell: the last one is the whole plane
    members = {LAYOUT.bpms.label(int(column)) for column in np.flatnonzero(patterns[:, group])}
    cause = Suspect(walk, (group,), {"step": 1e-8})
    moved = {
        one.label.removeprefix("the orbit at ")
        for one in proposals(LAYOUT, [cause], limits_of())
        if one.label.startswith("the orbit at ")
    }
    assert moved
    assert moved <= members


def test_an_effect_without_a_trace_is_planned_for_at_its_typical_size(
    weak: tuple[Bench, Plan],
) -> None:
    its = plan_for(weak[0], [effect("corrector-lag")])
    assert its.experiment.splits == ("corrector-lag",)
    assert its.experiment.separation_nats is not None
    assert its.experiment.separation_nats >= ENOUGH


def test_the_gain_of_the_loop_is_read_off_the_record(weak: tuple[Bench, Plan]) -> None:
    gains = loop_gains(weak[0].record)
    assert np.median(gains[:10]) == pytest.approx(0.35, abs=0.05)


def test_a_lasting_excursion_is_taken_back_by_the_feedback() -> None:
    response = LAYOUT.response
    mode = np.linalg.svd(response)[2][0]
    rows = np.tile(mode, (40, 1))
    moved = answered(rows, response, np.full(len(mode), 0.3)) @ mode
    assert moved[0] == pytest.approx(1.0)
    assert moved[1:4] == pytest.approx([0.7, 0.49, 0.343])


def test_every_value_of_every_effect_can_be_moved_a_little():
    for kind in all_effects().values():
        for parameter in kind.parameters:
            if parameter.high > parameter.low:
                for value in (parameter.nominal, parameter.typical):
                    step = plan_response._step(parameter, value)
                    assert 0.0 < abs(step) < np.inf, (kind.id, parameter.name)


@pytest.mark.parametrize("size", [2e-3, 6e-3])
def test_what_healthy_errors_take_of_a_change_is_that_of_dense_algebra(size: float) -> None:
    bench = Bench(recorded("corrector-gain", 50, {"gain": 0.0}, 250))
    rng = np.random.default_rng(4)
    moves = size * rng.standard_normal((100, len(LAYOUT.correctors)))
    shift = Cause(effect("tune-shift"), (), {"dnu_x": 0.01, "dnu_y": 0.0})
    view = outlook(bench, moves, exact=True)
    change = np.ravel(view.white(shift))
    own = Background(LAYOUT, view.record.setpoints, view.record.readings, view.record.starts, 1.0)
    own.prepare(bench.floor)
    healthy = np.stack(
        [
            np.ravel(bench.floor.whiten(own.orbit(unit), view.record.starts))
            for unit in np.eye(len(bench.sizes))
        ]
    )
    taken = np.linalg.solve(healthy @ healthy.T + np.eye(len(healthy)), healthy @ change)
    left = 0.5 * float(change @ change - (healthy @ change) @ taken)
    assert separation(view, shift, None) == pytest.approx(left, rel=0.02, abs=0.3)
    alone = separation(outlook(bench, moves), shift, None)
    assert left < 0.5 * alone  # a shift of the tune is what healthy gradients do
