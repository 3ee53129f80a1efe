"""From a record to the answer: what is there is named, what is not there is not."""

import json

import numpy as np
import pytest

from orbitfb.diagnose import engine
from orbitfb.diagnose.answer import Diagnosis, document
from orbitfb.diagnose.engine import diagnose
from orbitfb.diagnose.search import Outcome
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring
from orbitfb.records.record import Record

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)


def answer(*effects: str, seed: int = 3, ticks: int = 700, without=frozenset()) -> Diagnosis:
    plant_effects = build([parse_effect(text) for text in effects], LAYOUT, seed)
    record = simulate_record(
        RING, "x", ticks, seed, plant_effects, dither=2e-3, period=LAYOUT.period
    )
    return diagnose(record, None, None, seed=1, without=without, progress=lambda what, share: None)


@pytest.fixture(scope="module")
def healthy() -> Diagnosis:
    """The answer to a record in which nothing is wrong."""
    return answer(ticks=400)


def test_a_record_without_a_gap_has_no_cause(healthy):
    found = healthy
    assert found.state == "no_gap"
    assert found.causes == ()
    assert found.gap is not None and not found.gap.resolved


def test_a_wrong_corrector_is_named_with_its_size():
    found = answer("corrector-gain:gain=0.3,names=CL1A_C05")
    assert found.state == "named"
    (cause,) = found.causes
    assert (cause.effect, cause.places, cause.stage) == (
        "corrector-gain",
        ("CL1A_C05",),
        "actuator",
    )
    gain = cause.parameters["gain"]
    assert gain.low is not None and gain.high is not None
    assert gain.low < 0.3 < gain.high
    assert found.gap is not None and found.gap.resolved and found.gap.nats_per_tick is not None
    assert sum(v or 0 for v in found.gap.by_bpm.values()) == pytest.approx(
        found.gap.nats_per_tick, rel=1e-5
    )
    assert found.shrink is not None and (found.shrink.nats or 0.0) > 0.8
    json.loads(document(found), parse_constant=lambda text: pytest.fail(f"{text} in the JSON"))


def test_a_cause_without_a_value_is_answered():
    found = answer("corrector-stuck:names=CL1A_C05,from=50s")
    assert found.state == "named"
    (cause,) = found.causes
    assert (cause.effect, cause.places, cause.parameters) == ("corrector-stuck", ("CL1A_C05",), {})
    assert cause.onset_s == pytest.approx(30.0, abs=1.0)  # the record begins after 20 s


def test_what_is_not_in_the_library_is_not_named_for_sure():
    """Without its kind, a lag of all correctors must not become something else for certain."""
    found = answer(
        "corrector-lag:tau=0.1", without=frozenset({"corrector-lag", "corrector-resonance"})
    )
    assert found.state in ("unknown", "named_plus_remainder", "ambiguous")


def test_the_same_record_and_seed_give_the_same_answer(healthy):
    first, second = healthy, answer(ticks=400)
    volatile = {"provenance"}
    assert first.model_dump(exclude=volatile) == second.model_dump(exclude=volatile)
    assert np.isfinite(first.gap.nats_per_tick if first.gap else np.nan)


def searched(monkeypatch, record) -> list[tuple[Record, int, int]]:
    """The records that were searched, one after the other, for how many kinds and without whom."""
    parts: list[tuple[Record, int, int]] = []
    search = engine.search

    def noted(part, kinds, *rest, **named):
        parts.append((part, len(kinds), named["others"]))
        return search(part, kinds, *rest, **named)

    monkeypatch.setattr(engine, "search", noted)
    diagnose(record, None, None, seed=1, progress=lambda what, share: None)
    return parts


@pytest.mark.parametrize(
    ("effects", "looks"),
    [
        ((), [1, 0.5]),  # nothing in the first rows, nothing at the end
        ((f"bpm-offset:offset=3um,names={LAYOUT.bpms.names[30]},from=95s",), [1, 0.5, 1.25, 1.25]),
    ],
)
def test_the_end_of_a_record_is_looked_at_before_all_of_it(monkeypatch, effects, looks):
    """The record has 800 rows and begins at 20 s: the first four fifths end at 84 s."""
    plant_effects = build([parse_effect(text) for text in effects], LAYOUT, 3)
    record = simulate_record(RING, "x", 800, 3, plant_effects, period=LAYOUT.period)
    parts, counts, others = zip(*searched(monkeypatch, record), strict=True)
    assert [len(part) / len(parts[0]) for part in parts] == pytest.approx(looks, abs=0.01)
    assert all(part.time[0] == 0.0 for part in parts)  # what grows begins at 0
    # Before all of it is looked at in full, what has a chance is; the others count as choice.
    assert [few == 0 for few in others] == [True, True, False, True][: len(parts)]
    assert len({count + few for count, few in zip(counts, others, strict=True)}) == 1


def test_the_end_is_looked_at_whatever_may_have_a_chance_before(monkeypatch):
    monkeypatch.setattr(Outcome, "hopeful", property(lambda its: frozenset({"bpm-offset"})))
    record = simulate_record(RING, "x", 800, 3, (), period=LAYOUT.period)
    parts, counts, _ = zip(*searched(monkeypatch, record), strict=True)
    assert [len(part) / len(parts[0]) for part in parts] == pytest.approx([1, 0.5, 1.25], abs=0.01)
    assert counts[2] == 1
