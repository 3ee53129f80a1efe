"""Planned experiments: within their limits, readable by the loop, and they do resolve."""

import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulate import simulate_record
from benchmarks.small_ring import small_ring
from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Channels
from orbitfb.diagnose.experiments.asked import plan_for
from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.outlook import answered, base_rows, loop_gains, outlook
from orbitfb.diagnose.experiments.search import experiment_for, limits_of, plan
from orbitfb.diagnose.experiments.separation import separation
from orbitfb.diagnose.experiments.suspects import Suspect, change_of
from orbitfb.diagnose.experiments.words import ENOUGH
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.build import layout_of
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects, effect
from orbitfb.loop.excitation.design import check_excitation
from orbitfb.loop.excitation.file import read_excitation
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record
from orbitfb.safety.limits import LimitSettings
from tests.unit.hypotheses.small_records import kinds_for

RING = small_ring()
LAYOUT = layout_of(RING, "x", 0.1)
PLACE = 12


def recorded(
    name: str, values: Mapping[str, float], ticks: int, excitation: Matrix | None = None
) -> Record:
    rng = np.random.default_rng(1)
    its = effect(name).simulate(LAYOUT, np.array([PLACE]), values, rng)
    return simulate_record(
        RING, ticks=ticks, seed=3, effects=[its], steering=0, excitation=excitation
    )


def best(record: Record, name: str) -> Candidate:
    kinds = kinds_for(record)
    found = candidates_of(Workspace.of(record, kinds), [effect(name)], lambda text: None)
    return next(one for one in found if one.kind.id == name)


def test_pairs_that_were_found_together_are_predicted_together(weak: Workspace) -> None:
    """One that is of none of the pairs is not taken for the first of them."""
    talk = effect("corrector-crosstalk")
    parts = tuple(Suspect(talk, pair, {"share": 0.1}) for pair in ((3, 5), (9, 7)))
    both = Suspect(talk, (3, 5, 9, 7), {"share": 0.1}, parts=parts)
    changes = [change_of(one, weak.signals, weak.transform) for one in (both, *parts)]
    whole, first, second = (one.field for one in changes if one is not None)
    np.testing.assert_allclose(whole, first + second)
    assert not np.allclose(first, second)
    unknown = Suspect(talk, (3, 5, 9, 7), {"share": 0.1})
    assert change_of(unknown, weak.signals, weak.transform) is None


def gain_of(size: float, place: int = PLACE) -> Suspect:
    return Suspect(effect("corrector-gain"), (place,), {"gain": size})


@pytest.fixture(scope="module")
def weak() -> Workspace:
    """A record of a gain error that is too small to be seen in it."""
    record = recorded("corrector-gain", {"gain": 0.08}, 250)
    return Workspace.of(record, kinds_for(record))


@pytest.fixture(scope="module")
def alone(weak: Workspace) -> Plan:
    return plan(weak, gain_of(0.08))


def test_a_weak_gain_that_a_passive_record_hides_is_seen_after_the_plan(alone: Plan) -> None:
    rows = alone.waveform().excursion
    after = recorded("corrector-gain", {"gain": 0.08}, 250 + len(rows), excitation=rows)
    found = best(after, "corrector-gain")
    assert alone.experiment.text.startswith("To see corrector-gain of 0.08 better: ")
    assert found.places == (PLACE,)
    assert found.evidence > 0.4 * ENOUGH
    assert found.values["gain"] == pytest.approx(0.08, abs=0.02)


def test_a_plan_keeps_its_limits(weak: Workspace) -> None:
    write = LimitSettings(change_per_tick=0.05)
    its = plan(weak, gain_of(0.03), (), limits_of(2e-6, 3.0, write))
    rows = its.waveform().excursion
    channels = Channels("x", LAYOUT.bpms.names, LAYOUT.correctors.names, (), (), ())
    everything = np.ones(rows.shape[1], dtype=bool)
    check_excitation(its.waveform(), channels, LAYOUT.response, write, 1e-3, everything)
    orbit = np.sqrt(np.mean((rows @ LAYOUT.response.T) ** 2, axis=1))
    assert orbit.max() <= 2e-6 * 1.001
    assert its.experiment.orbit_cost_um == pytest.approx(orbit.max() * 1e6, rel=0.01)
    assert len(rows) * LAYOUT.period <= 180.5


@pytest.mark.parametrize("name", ["excite.toml", "excite.npz"])
def test_the_loop_reads_what_was_planned(alone: Plan, tmp_path: Path, name: str) -> None:
    alone.write(tmp_path / name)
    channels = Channels("x", LAYOUT.bpms.names, LAYOUT.correctors.names, (), (), ())
    read = read_excitation(tmp_path / name, channels, LAYOUT.response, LAYOUT.period)
    assert np.allclose(read.excursion, alone.waveform().excursion, atol=1e-7)
    assert read.wait == alone.waveform().wait
    if name.endswith("toml"):
        assert tomllib.loads((tmp_path / name).read_text())["part"]


def test_what_no_corrector_can_split_is_said_in_words(weak: Workspace) -> None:
    missed = Suspect(effect("missed-write"), (), {"probability": 0.01})
    jitter = Suspect(effect("clock-jitter"), (), {"rms": 0.01})
    its = plan(weak, missed, [jitter])
    assert its.settings is None
    assert "helps to tell missed-write from clock-jitter. Another test: Sequence" in (
        its.experiment.text
    )
    with pytest.raises(EstimationError, match="no excitation to run"):
        its.waveform()


def test_a_plan_splits_all_rivals_and_says_which_it_cannot(weak: Workspace) -> None:
    lag = Suspect(effect("corrector-lag"), (PLACE,), {"tau": 0.02})
    noise = Suspect(effect("noise-level"), (20,), {"factor": 1.5})
    its = plan(weak, gain_of(0.08), [gain_of(0.08, PLACE + 1), lag, noise]).experiment
    assert its.splits == ("corrector-gain", "corrector-gain", "corrector-lag")
    assert "corrector-gain and corrector-lag:" in its.text
    assert "does not tell corrector-gain from noise-level. For that: The spectrum" in its.text
    assert its.separation_nats is not None
    assert its.separation_nats >= ENOUGH


def test_a_group_of_bpms_is_no_bpm(weak: Workspace) -> None:
    """A place of a law that has no course is a pattern: there are more of them than BPMs."""
    walk = effect("bpm-walk")
    patterns = walk.patterns(LAYOUT)
    assert patterns.shape[1] > len(LAYOUT.bpms)
    several = Suspect(walk, (patterns.shape[1] - 1,), {"step": 1e-7})
    assert walk.devices_at(LAYOUT, several.places) == tuple(np.flatnonzero(patterns[:, -1]))
    its = plan(weak, gain_of(0.08), [several]).experiment
    assert its.splits == ("corrector-gain", "bpm-walk")


def test_candidates_of_a_record_that_cannot_decide_get_an_experiment(weak: Workspace) -> None:
    gain, lag = effect("corrector-gain"), effect("corrector-lag")
    one = Candidate(gain, (PLACE,), (), {"gain": 0.08}, 3.0, sizes=(0.08,))
    other = Candidate(lag, (PLACE,), (), {"tau": 0.02}, 2.0)
    its = experiment_for(weak, one, [other])
    assert its is not None
    assert its.splits == ("corrector-gain", "corrector-lag")
    assert its.devices
    short = Workspace.of(weak.signals.record.rows(0, 90), kinds_for(weak.signals.record))
    assert experiment_for(short, one, [other]) is None


def test_an_effect_without_a_trace_is_planned_for_at_its_typical_size(weak: Workspace) -> None:
    its = plan_for(weak, [effect("corrector-lag")])
    assert its.experiment.splits == ("corrector-lag",)
    assert its.experiment.separation_nats is not None
    assert its.experiment.separation_nats >= ENOUGH


@pytest.mark.parametrize("kind", all_effects().values(), ids=list(all_effects()))
def test_every_effect_of_typical_size_has_a_separation(kind: EffectKind, weak: Workspace) -> None:
    if kind.unavailable(weak.signals.record):
        pytest.skip("this record cannot show it")
    rng = np.random.default_rng(2)
    moves = 5e-3 * rng.standard_normal((base_rows(weak.signals.record), len(LAYOUT.correctors)))
    view = outlook(weak, moves, loop_gains(weak.signals.record), {})
    suspect = Suspect.typical(kind, weak.signals)
    seen, apart = (separation(view, suspect, other) for other in (None, gain_of(0.1)))
    assert np.isfinite([seen, apart]).all()
    assert min(seen, apart) >= 0.0
    assert separation(view, suspect, suspect) <= 1e-6 * seen


def test_an_error_of_the_ring_is_one_wherever_the_suspect_sits(weak: Workspace) -> None:
    """A delay of one corrector is an effect of the loop."""
    moves = np.zeros((100, len(LAYOUT.correctors)))
    gains = loop_gains(weak.signals.record)
    late = Suspect(effect("loop-delay"), (PLACE,), {"ticks": 1.0})
    assert late.kind.target == "ring"
    assert len(outlook(weak, moves, gains, {"ring": late.places}).terms) == 1  # it is longer


def test_the_gain_of_the_loop_is_read_off_the_record(weak: Workspace) -> None:
    gains = loop_gains(weak.signals.record)
    assert np.median(gains[:10]) == pytest.approx(0.35, abs=0.05)


def test_a_lasting_excursion_is_taken_back_by_the_feedback() -> None:
    mode = np.linalg.svd(LAYOUT.response)[2][0]
    rows = np.tile(mode, (40, 1))
    moved = answered(rows, LAYOUT.response, np.full(len(mode), 0.3)) @ mode
    assert moved[0] == pytest.approx(1.0)
    assert moved[1:4] == pytest.approx([0.7, 0.49, 0.343])


@pytest.mark.parametrize("size", [2e-3, 2e-2])
def test_what_healthy_errors_take_of_a_change_is_that_of_dense_algebra(
    weak: Workspace, size: float
) -> None:
    """Every error column as a field of its own, solved beside the change."""
    rng = np.random.default_rng(4)
    moves = size * rng.standard_normal((100, len(LAYOUT.correctors)))
    gains = loop_gains(weak.signals.record)
    shift = Suspect(effect("tune-shift"), (), {"dnu_x": 0.01, "dnu_y": 0.0})
    view = outlook(weak, moves, gains)
    bare = outlook(weak, moves, gains, {})
    terms = view.terms
    columns = [
        np.outer(terms.spectrum[:, c], terms.patterns[:, terms.pattern[c]])
        for c in range(len(terms))
    ]
    whiten = np.sqrt(1.0 / view.noise.variance(view.transform))
    change = change_of(shift, view.signals, view.transform)
    assert change is not None
    target = np.ravel((change.field @ view.noise.modes) * whiten)
    scaled = np.stack(
        [
            np.sqrt(v) * np.ravel((c @ view.noise.modes) * whiten)
            for c, v in zip(columns, view.variance, strict=True)
        ]
    )
    solved = np.linalg.solve(scaled @ scaled.T + np.eye(len(scaled)), scaled @ target)
    left = 0.5 * float(target @ target - (scaled @ target) @ solved)
    assert separation(view, shift, None) == pytest.approx(left, rel=0.05)  # it is told by band
    assert left < 0.5 * separation(bare, shift, None)
