"""Sizes that a record would have shown, held against exact likelihoods."""

import numpy as np
import pytest

from orbitfb.diagnose.ambiguity import classes, cosines, declared, identifiability
from orbitfb.diagnose.background import GAIN_RMS
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.detectable import detectable
from orbitfb.diagnose.detectable_random import ENOUGH
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import all_effects, effect
from orbitfb.physics.places import Ring


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(simulate_record(Ring.load(), ticks=400, seed=5))


def test_every_effect_is_either_sized_or_excused(bench: Bench) -> None:
    sizes, untested = detectable(bench, all_effects().values())
    told = [d.effect for d in sizes] + [n.effect for n in untested]
    assert sorted(told) == sorted(all_effects())
    assert {"bpm-roll", "corrector-roll", "skew-coupling"} <= {n.effect for n in untested}
    assert all(n.reason for n in untested)
    for one in sizes:
        if one.size is not None and one.best is not None and one.effect not in TURNED:
            assert 0.0 <= one.best <= one.size


TURNED = ("corrector-saturation", "corrector-slew", "corrector-resonance", "corrector-stuck")
"""Nothing is their largest value: there the best place has the larger one."""


@pytest.mark.parametrize("name", ["corrector-gain", "bpm-gain"])
def test_a_gain_of_the_size_told_gives_the_nats_promised(bench: Bench, name: str) -> None:
    kind = effect(name)
    (told,), _ = detectable(bench, [kind])
    assert told.size is not None
    layout = bench.record.layout
    gains = []
    for place in range(0, 180, 12):
        if name == "corrector-gain":
            change = np.outer(bench.currents[:, place], layout.response[:, place])
        else:
            change = np.zeros_like(bench.orbit)
            change[:, place] = bench.orbit[:, place]
        gains.append(0.5 * bench.information(told.size * change))
    assert np.median(gains) == pytest.approx(ENOUGH, rel=0.25)


def test_healthy_errors_do_their_best_against_a_gain_however_strongly_it_is_excited() -> None:
    layout = layout_of(Ring.load(), "x", 0.1)
    pattern = np.linalg.lstsq(layout.response, layout.response[:, 50], rcond=0.2)[0]
    levels = np.resize([1.0, -1.0, 2.0, -2.0], 300)[:, None]
    bench = Bench(
        simulate_record(Ring.load(), ticks=600, seed=3, excitation=0.2 * levels * pattern)
    )
    change = 0.06 * np.outer(bench.currents[:, 50], layout.response[:, 50])
    whole = 0.5 * np.sum(bench.floor.whiten(change, bench.record.starts) ** 2)
    left = 0.5 * bench.information(change)
    assert whole > 500.0
    assert left < 0.5 * (0.06 / GAIN_RMS) ** 2 * 1.1  # that much one healthy error costs


def test_more_ticks_show_less() -> None:
    kinds = [effect("corrector-gain"), effect("noise-level")]
    sizes = []
    for ticks in (250, 750):
        bench = Bench(simulate_record(Ring.load(), ticks=ticks, seed=6))
        sizes.append([one.size for one in detectable(bench, kinds)[0]])
    for short, long in zip(*sizes, strict=True):
        assert long < short


def test_same_change_has_cosine_one_and_unlike_ones_have_less(bench: Bench) -> None:
    gain, polarity, kick = (effect(n) for n in ("corrector-gain", "corrector-polarity", "bpm-gain"))
    found = cosines(
        bench,
        [
            Cause(gain, (40,), {"gain": -0.8}),
            Cause(polarity, (40,), {}),
            Cause(kick, (90,), {"gain": 0.3}),
        ],
    )
    assert found[0, 1] > 0.95
    assert abs(found[0, 2]) < 0.5
    assert np.allclose(found, found.T)


def test_classes_join_what_is_alike_and_near_and_nothing_else(bench: Bench) -> None:
    def entry(name: str, place: int, weight: float, **values: float) -> Entry:
        cause = Cause(effect(name), (place,), values)
        return Entry(Candidate(cause, weight, 1.0), None, weight)

    gain = entry("corrector-gain", 40, 30.0, gain=-0.9)
    polarity = entry("corrector-polarity", 40, 29.0)
    far = entry("corrector-lag", 40, 12.0, tau=0.2)
    other = entry("bpm-drift", 10, 28.0, rate=1e-8)
    groups = classes([gain, far, other, polarity], bench)
    assert [group.kinds for group in groups] == [
        ("corrector-polarity", "corrector-gain"),
        ("bpm-drift",),
        ("corrector-lag",),
    ]
    assert groups[0].splits
    report = identifiability(bench, [gain, polarity])
    assert report.effects == ("corrector-gain", "corrector-polarity")
    assert len(report.degenerate) == 1


def test_late_readings_and_late_correctors_are_declared_alike() -> None:
    known = declared(effect("loop-delay"), effect("bpm-latency"))
    assert known is not None
    assert "time stamps" in known.splits
    assert declared(effect("bpm-stuck"), effect("energy-ramp")) is None
