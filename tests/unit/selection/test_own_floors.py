"""What leads is weighed under a floor of its own: records in which the floor of all misleads."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection import own_floors, rounds, settled
from orbitfb.diagnose.selection.echoes import last_resort
from orbitfb.diagnose.selection.own_floors import Weighing, _Rivals, _under, refitted
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import NOISE, Bent, kinds_for, make_record

RING = small_ring()
LAYOUT = layout_of(RING, "x", 0.1)
ROWS = 900
PATTERN = LAYOUT.orbit_per_kick("QUAD", "x")[:, 12]


def record_with(orbit: Vector, seed: int) -> Record:
    """An open loop with setpoints that wander, moving magnets, noise, and an orbit besides."""
    rng = np.random.default_rng(seed)
    setpoints = (0.01 * rng.standard_normal((ROWS, LAYOUT.response.shape[1]))).cumsum(axis=0)
    magnets = LAYOUT.orbit_per_kick("QUAD", "x")
    moved = (2e-9 * rng.standard_normal((ROWS, magnets.shape[1]))).cumsum(axis=0)
    readings = setpoints @ LAYOUT.response.T + moved @ magnets.T + orbit
    readings += NOISE * rng.standard_normal(readings.shape)
    return replace(
        make_record(seed), layout=LAYOUT, readings=readings, setpoints=setpoints,
        requested=np.vstack([np.diff(setpoints, axis=0), setpoints[:1] * np.nan]),
        filled=np.zeros_like(readings, dtype=np.bool_),
    )  # fmt: skip


def scanned(record: Record) -> tuple[Workspace, list[Candidate]]:
    kinds = kinds_for(record)
    space = Workspace.of(record, kinds)
    return space, candidates_of(space, kinds)


@pytest.mark.nightly
def test_a_wave_and_a_walk_of_one_effect_are_weighed_each() -> None:
    """Over the floor of all the walk of the energy may lead; the wave is what it is."""
    wave = 8e-6 * np.sin(2.0 * np.pi * 0.031 * np.arange(ROWS) + 1.0)
    space, found = scanned(record_with(np.outer(wave, LAYOUT.dispersion()), 20))
    told = next(one for one in found if one.kind.id == "energy-drift" and one.walk is None)
    walks = next(one for one in found if one.kind.id == "energy-drift" and one.walk is not None)
    others = [one for one in found if one is not told and one is not walks]
    first = replace(walks, evidence=told.evidence + 1.0)
    best = refitted([first, told, *others], space).candidates[0]
    assert (best.kind.id, best.walk) == ("energy-drift", None)


def test_the_course_of_a_gap_is_told_over_the_floor_that_it_leaves() -> None:
    """Over the floor of all, which has learned the motion for its own, half of it is lost."""
    corners = np.arange(0, ROWS + 60, 60)
    kick = 3e-6 * np.random.default_rng(21).standard_normal(len(corners)).cumsum()
    course = np.interp(np.arange(ROWS), corners, kick)
    source = 12
    pattern = LAYOUT.orbit_per_kick("QUAD", "x")[:, source]
    space, found = scanned(record_with(np.outer(course, pattern), 21))
    best = refitted(found, space).candidates[0]
    assert best.kind.id == "insertion-device"
    assert best.names == (f"{RING.names('QUAD')[source]} (x)",)
    left = np.asarray(best.field) - space.transform.spectrum(np.outer(course, pattern))
    before = np.asarray(found[0].field) - space.transform.spectrum(np.outer(course, pattern))
    assert np.linalg.norm(left) < 0.95 * np.linalg.norm(before)
    assert best.evidence > 2.0 * found[0].evidence


def test_a_law_is_weighed_under_its_own_floor_though_noise_leads() -> None:
    """What the floor of all has learned of a law looks like odd noise."""
    wave = 8e-6 * np.sin(2.0 * np.pi * 0.031 * np.arange(ROWS) + 1.0)
    space, found = scanned(record_with(np.outer(wave, LAYOUT.dispersion()), 20))
    told = next(one for one in found if one.kind.id == "energy-drift" and one.walk is None)
    noise = Candidate(
        effect("noise-coloured"), (), (), {"correlation": -0.2}, told.evidence + 1.0, noisy=True
    )
    best = refitted([noise, told], space).candidates[0]
    assert best.kind.id == "energy-drift"
    assert best.evidence > told.evidence


def test_a_line_is_told_until_it_is_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its second telling, over the first floor without it, is not the last."""
    space, found = scanned(record_with(np.outer(5e-6 * np.sin(0.2 * np.arange(ROWS)), PATTERN), 23))
    line = next(one for one in found if one.kind.id == "periodic-disturbance")
    whole, tellings = np.asarray(line.field), [0.5]

    def told(one: Candidate, after: Workspace) -> Candidate:
        tellings.append(0.5 * (1.0 + tellings[-1]))
        return replace(one, field=tellings[-1] * whole)

    monkeypatch.setattr(settled, "_told", told)
    refitted([replace(line, field=0.5 * whole)], space)
    assert len(tellings) > 2


def test_what_a_telling_makes_less_likely_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The floor that a cause leaves is no judge of what it has already."""
    space, found = scanned(record_with(np.outer(5e-6 * np.sin(0.2 * np.arange(ROWS)), PATTERN), 23))
    line = next(one for one in found if one.kind.id == "periodic-disturbance")

    def told(one: Candidate, after: Workspace) -> Candidate:
        return replace(one, field=3.0 * np.asarray(one.field))

    monkeypatch.setattr(settled, "_told", told)
    best = refitted([line], space).candidates[0]
    assert np.array_equal(np.asarray(best.field), np.asarray(line.field))


@pytest.mark.parametrize("coloured", [True, False])
def test_of_a_bpm_whose_noise_remembers_no_law_of_its_readings_is_told(
    coloured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A feedback makes the beam follow such noise, which looks like a law of what is read."""
    record = make_record(40)
    noise = Candidate(
        effect("noise-coloured"), (3,), ("B3 (x)",), {"correlation": 0.8}, 400.0,
        noisy=True, coloured=coloured,
    )  # fmt: skip
    late = Candidate(effect("bpm-latency"), (3,), ("B3 (x)",), {"ticks": 1.0}, 100.0)
    found = iter(([noise, late], [late], []))
    monkeypatch.setattr(rounds, "candidates_of", lambda *given: next(found))
    monkeypatch.setattr(rounds, "refitted", lambda found, space, *given: Weighing(found, space))
    accepted, _ = rounds.tournament(Workspace.of(record, [effect("bpm-gain")]), [])
    assert accepted == ([noise] if coloured else [noise, late])


@pytest.mark.nightly
def test_a_rival_shows_under_the_floor_of_what_leads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over the floor of all, which has learned what a corrector does not do, nothing tells them."""
    record = record_with(np.zeros(len(LAYOUT.bpms)), 22)
    acting = record.setpoints.copy()
    acting[300:, 5] = acting[299, 5]
    stuck = record.readings + (acting - record.setpoints) @ LAYOUT.response.T
    space, found = scanned(replace(record, readings=stuck))
    late = [one for one in found if one.cost is not None and one.onset]
    slew = next(one for one in late if one.kind.id == "corrector-slew")
    true = next(one for one in late if one.kind.id == "corrector-stuck")
    monkeypatch.setattr(own_floors, "LEADING", 1)
    first = replace(slew, evidence=true.evidence + 1.0)
    least = replace(true, evidence=0.2 * true.evidence)
    best, second = refitted([first, least], space).candidates
    assert (best.kind.id, second.kind.id) == ("corrector-stuck", "corrector-slew")
    assert best.evidence > 1.1 * true.evidence


@pytest.mark.nightly
def test_under_the_floor_of_another_one_none_has_more_than_under_its_own() -> None:
    """And that of the one whose floor it is has there what it has."""
    space, found = scanned(record_with(np.outer(5e-6 * np.sin(0.2 * np.arange(ROWS)), PATTERN), 23))
    told = [one for one in found if one.additive and one.cost is not None and one.evidence > 0.0]
    space = space.saturable()
    base = space.with_floor().log_posterior()
    own = [refitted([one], space).candidates[0] for one in told]
    best = int(np.argmax([one.evidence for one in own]))
    told[best], after = own[best], own[best].after
    assert after is not None
    lower = over(space, after)
    under = _under(told, lower, lower.log_posterior() - base)
    most = own[best].evidence
    assert under[best] == pytest.approx(most, rel=0.01)
    for number, evidence in under.items():
        assert evidence < own[number].evidence + 0.01 * most, told[number].describe()


def test_a_form_of_an_effect_does_not_stand_for_another_one() -> None:
    """Two BPMs whose gains are wrong, each by another factor, told after a single one."""
    record = make_record(90, gain=0.0)
    gains = np.ones(record.readings.shape[1])
    gains[[3, 9]] = [1.25, 0.8]
    record = replace(record, readings=record.readings * gains)
    space = Workspace.of(record, kinds_for(record))
    found = candidates_of(space, [effect("bpm-gain")])
    single = next(one for one in found if one.sources and len(one.places) == 1)
    some = next(one for one in found if one.columns)
    assert some.evidence > 1.5 * single.evidence
    best, *_ = refitted([replace(single, evidence=2.0 * some.evidence), some], space).candidates
    assert best.places == (3, 9)
    assert best.evidence > 0.9 * some.evidence


def later(ticks: int) -> Bent:
    """Setpoints that come into force some rows later."""
    return lambda currents: currents[[max(len(currents) - 1 - ticks, 0)]]


def test_a_cause_is_weighed_against_the_best_floor_without_one() -> None:
    """A saturated model takes up most of a delay; over the floor of the rest the delay is huge."""
    record = make_record(5, currents=later(1), dither=0.2)
    kinds = kinds_for(record)
    space = Workspace.of(record, kinds)
    found = candidates_of(space, kinds)
    weighing = refitted(found, space)
    best, bare = weighing.candidates[0], weighing.bare
    assert best.kind.id == "loop-delay"
    assert best.evidence < 0.1 * found[0].evidence
    for one in found[:8]:
        without = over(space, one.accepted(space.saturable())).log_posterior()
        assert without < bare.log_posterior() + best.evidence  # the cause is likelier than none


def test_a_delay_of_a_loop_that_swings_is_found_beyond_the_best_of_the_scan() -> None:
    """Scanned, it is best at 1.5 ticks; exactly it rises until 2, two steps of the grid away."""
    record = make_record(5, currents=later(2), gain=0.55)
    kinds = kinds_for(record)
    accepted, _ = rounds.tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["loop-delay"]
    assert accepted[0].values["ticks"] == pytest.approx(2.0, abs=0.05)


def odd_noise(evidence: float) -> Candidate:
    """A BPM whose noise is unlike that of the others."""
    return Candidate(
        effect("noise-level"), (3,), ("B3 (x)",), {"factor": 2.0}, evidence,
        noisy=True, courseless=True,
    )  # fmt: skip


def test_an_odd_noise_is_told_beside_a_louder_ground_but_not_beside_a_law() -> None:
    """A law that is not known yet adds to the noise of its BPM, and so does common noise."""
    odd = odd_noise(260.0)
    ground = Candidate(effect("ground-motion-level"), (), (), {"factor": 2.0}, 159.0, noisy=True)
    law = Candidate(effect("bpm-gain"), (3,), ("B3 (x)",), {"gain": 0.1}, 100.0)
    common = Candidate(effect("noise-correlated"), (0,), ("C0 (x)",), {}, 100.0, noisy=True)
    assert last_resort([odd, ground], before=None, drawn=False) == [odd, ground]
    for one in (law, common):
        assert last_resort([odd, one], before=None, drawn=False) == [one]


@pytest.mark.parametrize(
    ("kind", "drawn", "least"),
    [
        ("corrector-hysteresis", False, 0.5),
        ("corrector-hysteresis", True, 0.03),
        ("clock-jitter", False, 0.03),
        ("clock-jitter", True, 0.03),
    ],
)
def test_an_odd_noise_is_told_beside_a_weak_law(kind: str, drawn: bool, least: float) -> None:
    """A law that makes the noise of a BPM odd says more than that it is, or a share of it."""
    odd = odd_noise(2000.0)
    if drawn:  # what a few readings that were drawn lack is no more than that
        odd = replace(odd, kind=effect("noise-tails"), courseless=False)
    weak = Candidate(effect(kind), (), (), {}, 0.8 * least * 2000.0)
    strong = replace(weak, evidence=1.2 * least * 2000.0)
    assert last_resort([odd, weak], before=None, drawn=drawn) == [odd, weak]
    assert last_resort([odd, strong], before=None, drawn=drawn) == [strong]


def test_beside_a_law_a_bpm_is_odd_that_was_as_odd_before() -> None:
    """What a law that is a little wrong leaves is a share of what was odd without it."""
    odd = odd_noise(212.0)
    for before, told in ((220.0, [odd]), (2000.0, []), (0.0, [])):
        assert last_resort([odd], before=before, drawn=False) == told


def test_of_candidates_with_like_evidence_the_weighed_one_leads() -> None:
    """One that was only scanned has no field: accepted, it would explain nothing."""
    scanned = Candidate(effect("bpm-gain"), (), (), {"gain": 0.1}, 20.3)
    weighed = Candidate(
        effect("bpm-gain"), (3,), ("B3 (x)",), {"gain": 0.1}, 15.5, field=np.ones((3, 2)), cost=1.0
    )
    rivals = _Rivals([scanned, weighed], [20.3, 15.5], 12.0, False)
    rivals.own[1] = replace(weighed, evidence=18.8)
    assert rivals.ranked()[0].field is not None


@pytest.mark.parametrize(("cost", "weighed"), [(0.0, None), (18.0, 0)])
def test_what_adds_much_is_weighed_though_its_costs_leave_little(
    cost: float, weighed: int | None
) -> None:
    """A floor hides a share of all that a law adds, and not of what its costs leave of that."""
    one = Candidate(
        effect("insertion-device"), (3,), ("Q3 (x)",), {"kick": 1e-7}, 4.0,
        field=np.ones((3, 2)), cost=cost,
    )  # fmt: skip
    assert _Rivals([one], [one.evidence], 12.0, False).next() == weighed
