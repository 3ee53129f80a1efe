"""What goes with the correctors is no noise of a BPM."""

from dataclasses import replace

import numpy as np
import pytest
from test_drift_memory import GoingOn
from test_scans import LAYOUT, RING

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.departure import departure
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_follows import follows
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.plant import PlantSettings

OWN, OTHER = 14, 30
NAME = LAYOUT.bpms.names[OWN]


def record(*effects, dither, seed=5):
    built = build([parse_effect(text) for text in effects], LAYOUT, 1)
    return simulate_record(
        RING, "x", 600, seed, built, dither=dither, steering_rms=50e-6, period=LAYOUT.period
    )


def with_own(quiet, readings):
    told = quiet.readings.copy()
    told[:, OWN] = readings
    return replace(quiet, readings=told)


@pytest.mark.parametrize("kind", ["noise-level", "bpm-walk"])
def test_what_another_bpm_reads_or_a_curved_scale_is_no_noise(kind):
    quiet = record(dither=1e-3)
    own = quiet.readings[:, OWN]
    heard = with_own(quiet, own + 0.3 * quiet.readings[:, OTHER])
    bent = with_own(quiet, 20e-6 * np.tanh(own / 20e-6))
    cause = Cause(all_effects()[kind], (OWN,), {})
    course, nats = follows(Bench(heard), cause)
    assert course.endswith(f"as what correctors do at {LAYOUT.bpms.label(OTHER)}")
    assert nats > 50.0
    assert follows(Bench(bent), cause)[1] > 50.0
    law = departure(Bench(heard), cause, 500.0, before=Bench(heard))
    assert law.nameless
    assert law.course == course


def test_what_goes_with_the_product_of_two_of_its_cell_is_no_noise():
    quiet = record(dither=1e-3)
    bpms = LAYOUT.bpms
    one, other = [c for c, cell in enumerate(bpms.cells) if cell == bpms.cells[OWN] and c != OWN][
        :2
    ]
    mixed = quiet.readings[:, one] * quiet.readings[:, other] / 20e-6
    bench = Bench(with_own(quiet, quiet.readings[:, OWN] + mixed))
    course, nats = follows(bench, Cause(all_effects()["bpm-walk"], (OWN,), {}))
    assert course.endswith(
        f"the product of what is read at {bpms.label(one)} and {bpms.label(other)}"
    )
    assert nats > 30.0


@pytest.mark.parametrize("dither", [0.0, 1e-3])
@pytest.mark.parametrize(
    "effect", ["noise-level:factor=6", "bpm-walk:step=1e-6", "noise-coloured:correlation=0.7"]
)
def test_noise_that_the_loop_acts_on_does_not_go_with_the_correctors(effect, dither):
    kind = effect.partition(":")[0]
    nats = [
        follows(
            Bench(record(f"{effect},names={NAME}", dither=dither, seed=seed)),
            Cause(all_effects()[kind], (OWN,), {}),
        )[1]
        for seed in (1, 2, 3)
    ]
    assert max(nats) <= 0.0


def test_correctors_that_follow_a_drift_that_goes_on_tell_of_no_bpm():
    drift = GoingOn(1001, 0.6, np.random.default_rng(2))
    still = PlantSettings(ground_motion_rms=0.0)
    bench = Bench(simulate_record(RING, "x", 800, 3, [drift], plant=still, steering=0))
    found = [
        follows(bench, Cause(all_effects()["noise-level"], (own,), {}))[1]
        for own in range(OWN, len(LAYOUT.bpms), 30)
    ]
    assert max(found) < 5.0
