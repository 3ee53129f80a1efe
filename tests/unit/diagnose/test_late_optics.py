"""What begins in the middle of a record that only changes of the golden orbit excite."""

import pytest

from orbitfb.diagnose.around import around
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import enter
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
BEGINS = 600
"""Row: the record begins after 20 s of 0.1 s."""
GRADIENT = "quadrupole-gradient"


def record_with(effect: str, seed: int, size: float = 40e-6, plant: PlantSettings | None = None):
    made = build([parse_effect(f"{effect},from=80s")], LAYOUT, 1)
    return simulate_record(
        RING, "x", 1200, seed, made, period=0.1, steering=8, steering_rms=size, plant=plant
    )


def place_of(record, name: str) -> int:
    names = all_effects()[GRADIENT].places_of(record.layout)
    return next(place for place, its in enumerate(names) if its.startswith(name))


@pytest.mark.parametrize("seed", [5, 6])
def test_a_gradient_that_healthy_errors_share_is_found_where_and_when_it_begins(seed):
    """Healthy errors take half of it at all times; the floor takes what they leave for drift."""
    record = record_with(f"{GRADIENT}:gradient=0.012,names=QM1A_C10", seed)
    bench, kind = Bench(record), all_effects()[GRADIENT]
    place = place_of(record, "QM1A_C10")
    true = fit(bench, (Cause(kind, (place,), {"gradient": 0.012}, BEGINS),))
    found, *_ = tournament(bench, [kind])
    assert found.cause.places == (place,)
    assert abs(found.cause.onset - BEGINS) < 60
    assert found.gain > true.gain - 5.0
    assert found.cause.values["gradient"] == pytest.approx(0.012, rel=0.1)


def test_a_beginning_is_sought_over_rows_that_say_nothing():
    """Between two changes of the golden orbit no row is likelier than the next one."""
    centred = PlantSettings(initial_orbit_rms=0.0)
    record = record_with(f"{GRADIENT}:gradient=0.004,names=QL2A_C01", 5, 15e-6, centred)
    bench, kind = Bench(record), all_effects()[GRADIENT]
    place = place_of(record, "QL2A_C01")

    def gain(row: int) -> float:
        return fit(bench, (Cause(kind, (place,), {"gradient": 0.004}, row),)).gain

    far = BEGINS + 160
    assert abs(gain(far) - gain(far - 50)) < 5.0
    late = Cause(kind, (place,), {"gradient": 0.004}, far)
    entry = enter(bench, Candidate(late, gain(far), 300.0 * len(record)))
    assert entry.gain > gain(BEGINS) - 5.0
    assert entry.cause.onset == BEGINS


def test_the_neighbour_that_explains_more_is_proposed():
    centred = PlantSettings(initial_orbit_rms=0.0)
    record = record_with(f"{GRADIENT}:gradient=0.004,names=QL2A_C01", 5, 15e-6, centred)
    bench, kind = Bench(record), all_effects()[GRADIENT]
    place, beside = (place_of(record, name) for name in ("QL2A_C01", "QL1A_C01"))
    cause = Cause(kind, (beside,), {"gradient": 0.01}, BEGINS)
    entry = enter(bench, Candidate(cause, 100.0, 300.0 * len(record)))
    proposed = {one.cause.places: one for one in around(bench, [entry])}
    assert (place,) in proposed
    one = proposed[(place,)]
    assert one.gain == pytest.approx(fit(bench, (one.cause,)).gain, rel=0.1)
    assert one.gain > entry.gain
    assert not around(bench, [])


def test_correctors_with_nearly_the_orbit_of_the_best_are_proposed_whatever_the_law():
    made = build([parse_effect("corrector-slew:rate=0.02,names=CH2A_C04")], LAYOUT, 1)
    record = simulate_record(RING, "x", 600, 5, made, dither=2e-3, period=0.1)
    bench, kind = Bench(record), all_effects()["corrector-slew"]
    true = LAYOUT.correctors.names.index("CH2A_C04")
    beside = Cause(kind, (true - 1,), {"rate": 0.03})
    entry = enter(bench, Candidate(beside, 100.0, 1800.0))
    found = {one.cause.places: enter(bench, one) for one in around(bench, [entry])}
    assert found[(true,)].gain > entry.gain + 5.0


def test_pairs_next_to_the_best_share_a_corrector_with_it_in_its_plane():
    made = build([parse_effect("corrector-crosstalk:share=0.2,names=CH2A_C04+CM1A_C04")], LAYOUT, 1)
    record = simulate_record(RING, "x", 600, 5, made, dither=2e-3, period=0.1)
    bench, kind = Bench(record), all_effects()["corrector-crosstalk"]
    assert isinstance(kind, PairKind)
    names, pairs = LAYOUT.correctors.names, kind.pairs(record.layout)
    true = (names.index("CH2A_C04"), names.index("CM1A_C04"))
    index = {tuple(pair): place for place, pair in enumerate(pairs.tolist())}
    cause = Cause(kind, (index[true[0], true[1] + 1],), {"share": 0.1})
    entry = enter(bench, Candidate(cause, 100.0, 1800.0))
    found = [one.cause.places[0] for one in around(bench, [entry])]
    assert found[0] == index[true]
    assert all(set(pairs[place]) & {true[0], true[1] + 1} for place in found)
