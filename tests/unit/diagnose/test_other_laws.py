"""The nearest effect of the library is told from what it stands for: another orbit, another noise.

Every record has an effect that its cause is not; the same cause on its own record departs from
nothing.
"""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.departure import Departure, departure
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.judgement import beside_themselves
from orbitfb.diagnose.latent_laws import latent_laws
from orbitfb.diagnose.noise_otherwise import otherwise
from orbitfb.diagnose.other_orbit import other_orbit
from orbitfb.diagnose.randomness import noise_candidates
from orbitfb.diagnose.rhythm import rhythm
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
CORRECTORS, BPMS = LAYOUT.correctors.names, LAYOUT.bpms.names


def record_with(effect: str = "", *, dither: float = 0.0, ticks: int = 900):
    made = build([parse_effect(effect)] if effect else [], LAYOUT, 1)
    return simulate_record(RING, "x", ticks, 5, made, dither=dither, period=LAYOUT.period)


@pytest.mark.parametrize(
    ("effect", "right"),
    [
        ("corrector-gain:gain=0.3,names=CL1A_C05", True),
        ("corrector-crosstalk:share=0.25,names=CL1A_C05+CM1A_C05", False),
    ],
)
def test_a_gain_is_not_told_for_a_corrector_that_moves_another(effect, right):
    record = record_with(effect, dither=2e-3)
    place = CORRECTORS.index("CL1A_C05")
    found = fit(Bench(record), (Cause(all_effects()["corrector-gain"], (place,), {"gain": 0.1}),))
    left = other_orbit(Bench(record, found.causes), found.causes[0])
    assert found.gain > 30.0
    assert (left < 0.02 * found.gain + 3.0) == right
    assert (left > 0.2 * found.gain) == (not right)


def test_of_what_does_nothing_and_of_bpms_no_orbit_is_told():
    record = record_with(dither=2e-3)
    for name, values in (("corrector-gain", {"gain": 0.0}), ("bpm-gain", {"gain": 0.3})):
        cause = Cause(all_effects()[name], (5,), values)
        assert other_orbit(Bench(record, (cause,)), cause) == 0.0


@pytest.mark.parametrize("true", ["missed-write:probability=0.02", "clock-jitter:rms=10ms"])
@pytest.mark.parametrize("name", ["missed-write", "clock-jitter"])
def test_a_lost_write_is_not_told_for_a_late_sample(true, name):
    bench = Bench(record_with(true, dither=2e-3))
    found = latent_candidates(bench, all_effects()[name])[0]
    laws = dict(latent_laws(bench, found.cause))
    assert len(laws) == 3
    its = departure(bench, found.cause, found.gain)
    if true.startswith(name):
        assert its.chance > 0.8
        # rows beside a strike hear it, and speak for no other law
        assert laws["now and then by another amount"] < 0.0
    else:
        assert its.chance < 0.1


@pytest.mark.parametrize(("dither", "spread"), [(2e-4, 0.03), (1e-3, 0.01), (2e-3, 0.05)])
def test_samples_that_are_only_ever_early_are_a_jitter(dither, spread):
    quiet = record_with(dither=dither)
    early = np.maximum(spread * np.random.default_rng(5).standard_normal(len(quiet)), 0.0)
    moved = np.diff(quiet.setpoints, axis=0, prepend=quiet.setpoints[:1])
    before = -early[:, None] * (moved @ quiet.layout.response.T)
    bench = Bench(replace(quiet, readings=quiet.readings + before))
    found = latent_candidates(bench, all_effects()["clock-jitter"])[0]
    assert found.gain > 50.0
    assert departure(bench, found.cause, found.gain, before=bench).chance > 0.8


def test_a_jitter_that_shows_when_the_orbit_is_moved_goes_by_no_clock():
    quiet = record_with()
    steps = 3e-2 * (np.arange(len(quiet)) // 40 % 2)[:, None] * np.eye(len(CORRECTORS))[30]
    share = 0.05 * np.random.default_rng(5).standard_normal(len(quiet))
    moved = np.diff(steps, axis=0, prepend=steps[:1]) @ quiet.layout.response.T
    readings = quiet.readings + steps @ quiet.layout.response.T + share[:, None] * moved
    bench = Bench(replace(quiet, readings=readings, setpoints=quiet.setpoints + steps))
    found = latent_candidates(bench, all_effects()["clock-jitter"])[0]
    assert rhythm(bench, found.cause) == 0.0
    assert departure(bench, found.cause, found.gain, before=bench).chance > 0.8


@pytest.mark.parametrize("together", [False, True])
def test_what_strikes_a_crate_in_the_same_rows_is_no_spike_of_each(together):
    record = record_with()
    crate = [column for column, name in enumerate(BPMS) if name.endswith("C14")]
    rng = np.random.default_rng(4)
    struck = rng.random((len(record), 1 if together else len(crate))) < 0.02
    readings = record.readings.copy()
    readings[:, crate] += struck * 0.5e-6 * rng.standard_normal((len(record), len(crate)))
    bench, kind = Bench(replace(record, readings=readings)), all_effects()["noise-tails"]
    cause = Cause(kind, tuple(crate), {"probability": 0.02, "amplitude": 0.5e-6})
    nats = dict(latent_laws(bench, cause))["in the same rows at all of them"]
    assert (nats > 30.0) == together
    assert (nats < 0.0) == (not together)
    alone = replace(cause, places=cause.places[:1])
    assert not dict(latent_laws(bench, alone))


@pytest.mark.parametrize(
    "true", ["noise-level:factor=1.4,cells=C14", "noise-correlated:rms=80nm,cells=C14"]
)
@pytest.mark.parametrize("name", ["noise-level", "noise-correlated"])
def test_bpms_that_are_noisy_by_themselves_have_no_noise_in_common(true, name):
    bench = Bench(record_with(true))
    kind = all_effects()[name]
    found = noise_candidates(bench, kind)[0]
    laws = dict(otherwise(bench, found.cause, found.gain))
    shared = max(nats for words, nats in laws.items() if " noise of " in words)
    assert laws["all in a single row"] < 0.0
    if true.startswith(name):
        assert shared < 3.0
    else:
        assert shared > 20.0


@pytest.mark.parametrize(
    "true",
    [
        "bpm-walk:step=60nm",
        "bpm-walk:step=30nm",
        "bpm-offset:offset=1um,from=50s",
        "bpm-offset:offset=0.6um,from=50s",
    ],
)
def test_what_jumps_once_does_not_walk(true):
    bench = Bench(record_with(f"{true},names={BPMS[40]}"))
    kind = all_effects()["bpm-walk"]
    found = noise_candidates(bench, kind)[0]
    assert found.cause.places == (40,)
    its = departure(bench, found.cause, found.gain)
    assert (its.course == "as a step that stays") == true.startswith("bpm-offset")
    assert (its.chance < 0.5) == true.startswith("bpm-offset")


@pytest.mark.parametrize("moment", [False, True])
def test_one_row_makes_no_level(moment):
    record = record_with()
    cause = Cause(all_effects()["ground-motion-level"], (), {"factor": 3.0}, onset=200)
    if moment:
        readings = record.readings.copy()
        readings[30:] += 2e-6 * np.random.default_rng(3).standard_normal(readings.shape[1])
        record = replace(record, readings=readings)
    nats = dict(otherwise(Bench(record), cause, 300.0))["all in a single row"]
    assert (nats > 50.0) == moment
    assert (nats < 3.0) == (not moment)


class _Entry:
    def __init__(self, name, places, gain):
        self.kind = all_effects()[name]
        self.cause, self.gain = Cause(self.kind, places, {}), gain


def test_two_laws_of_the_very_same_devices_are_neither():
    found = [_Entry("bpm-gain", (7,), 200.0), _Entry("bpm-current", (7,), 90.0)]
    others = [_Entry("corrector-gain", (7,), 100.0), _Entry("missed-write", (), 60.0)]
    lawful = Departure("", 0.0, 100.0)
    told = beside_themselves([(entry, lawful) for entry in (*found, *others)])  # type: ignore[misc]
    assert [its.nats for its in told] == [90.0, 90.0, 0.0, 0.0]
    assert told[0].gain == 200.0
    assert told[0].chance < 0.1
    assert told[2] is lawful


@pytest.mark.parametrize(
    ("name", "told"),
    [("periodic-disturbance", 0.0), ("insertion-device", 0.0), ("local-kick", 90.0)],
)
def test_harmonics_and_further_moves_of_one_source_are_no_second_law(name, told):
    found = [_Entry(name, (7,), 200.0), _Entry(name, (7,), 90.0)]
    lawful = Departure("", 0.0, 100.0)
    departures = beside_themselves([(entry, lawful) for entry in found])  # type: ignore[misc]
    assert [its.nats for its in departures] == [told, told]
