"""What takes many effects at once is one that the library lacks."""

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.impact.named import named
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection import rounds
from orbitfb.diagnose.selection.own_floors import Weighing
from orbitfb.diagnose.verdict.state import judged
from orbitfb.diagnose.verdict.unknown import unknown_of
from orbitfb.effects.registry import effect
from tests.unit.hypotheses.small_records import make_record

BROAD = {0: 2.0}


def causes(*told: tuple[str, float]) -> list[Candidate]:
    return [Candidate(effect(name), (), (), {}, nats, noisy=True) for name, nats in told]


def found(
    monkeypatch: pytest.MonkeyPatch, *told: Candidate, asked: list[float] | None = None
) -> tuple[list[Candidate], list]:
    """A tournament in which each of them leads a round, and then none.

    Args:
        monkeypatch: Takes the place of what is searched.
        told: They.
        asked: Gets what healthy motion would have to beat [nats].
    """
    enough = [] if asked is None else asked
    ahead = iter([one] for one in told)
    monkeypatch.setattr(rounds, "candidates_of", lambda *given: next(ahead, []))
    monkeypatch.setattr(rounds, "refitted", lambda found, space, *given: Weighing(found, space))
    monkeypatch.setattr(rounds, "with_motion", lambda space, nats: enough.append(nats))
    monkeypatch.setattr(Candidate, "accepted", lambda one, space, spread=True: space)
    return rounds.tournament(Workspace.of(make_record(41), [effect("bpm-gain")]), [])


def test_a_third_effect_is_told_as_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    told = causes(("corrector-slew", 400.0), ("corrector-lag", 300.0), ("corrector-roll", 200.0))
    accepted, its = found(monkeypatch, *told)
    assert accepted == told[:2]
    verdict = judged(named(accepted, its), its)
    assert (verdict.state, verdict.nats) == ("named_plus_remainder", 200.0)
    unknown = unknown_of(verdict, named(accepted, its))
    assert unknown is not None
    assert effect("corrector-roll").title in unknown.text


def test_where_more_is_left_than_was_named_nothing_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = causes(("corrector-slew", 400.0), ("corrector-lag", 300.0), ("corrector-roll", 900.0))
    accepted, its = found(monkeypatch, *told)
    assert judged(named(accepted, its), its).state == "unknown"


@pytest.mark.parametrize(
    "told",
    [
        causes(("corrector-slew", 400.0), ("corrector-slew", 300.0), ("corrector-slew", 200.0)),
        causes(("corrector-slew", 4000.0), ("corrector-lag", 3000.0), ("corrector-roll", 100.0)),
    ],
    ids=["devices of one effect", "a small third one"],
)
def test_what_is_one_or_hardly_counts_is_accepted(
    told: list[Candidate], monkeypatch: pytest.MonkeyPatch
) -> None:
    accepted, its = found(monkeypatch, *told)
    assert accepted == told
    assert judged(named(accepted, its), its).state == "named"


@pytest.mark.parametrize(("nats", "ends"), [(950.0, True), (900.0, False)])
def test_after_two_causes_an_unknown_law_of_all_that_is_likelier_ends_it(
    nats: float, ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All three have 900 nats, and it has to be surely likelier."""
    names = ("corrector-slew", 400.0), ("corrector-lag", 300.0), ("corrector-slew", 200.0)
    free = FreeCourse("corrector", (), nats)
    monkeypatch.setattr(rounds, "unknown_laws", lambda *given: [free])
    accepted, its = found(monkeypatch, *causes(*names))
    assert len(accepted) == (2 if ends else 3)
    assert (judged(named(accepted, its), its).state == "unknown") is ends


def test_an_unknown_law_of_all_is_a_rival_of_healthy_motion_until_a_cause_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside a cause it may be a share of that."""
    asked: list[float] = []
    free = FreeCourse("corrector", (), 350.0)
    monkeypatch.setattr(rounds, "unknown_laws", lambda *given: [free])
    told = causes(("corrector-slew", 340.0), ("corrector-slew", 200.0))
    found(monkeypatch, *told, asked=asked)
    assert asked == [350.0, 200.0]


def test_errors_of_all_devices_are_one_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that was never calibrated has them of gains, calibrations and gradients."""
    names = ("bpm-gain", "corrector-gain", "quadrupole-gradient")
    told = [Candidate(effect(one), (), (), {}, 300.0, raised=BROAD) for one in names]
    accepted, _ = found(monkeypatch, *told)
    assert accepted == told


@pytest.mark.parametrize(("cycles", "kept"), [(0.05 + 1e-4, False), (0.05 + 1e-2, True)])
def test_what_a_wave_leaves_where_the_optics_are_wrong_is_that_wave(
    monkeypatch: pytest.MonkeyPatch, cycles: float, kept: bool
) -> None:
    """A hum of BPMs of the same frequency, to what 900 rows can tell."""
    names = ("periodic-disturbance", 0.05), ("bpm-hum", cycles)
    told = [
        Candidate(
            effect(name), (1,), ("1",), {}, nats, field=np.zeros((899, 16)), cost=0.0, cycles=its
        )
        for (name, its), nats in zip(names, (400.0, 300.0), strict=True)
    ]
    accepted, _ = found(monkeypatch, *told)
    assert [one.kind.id for one in accepted] == [name for name, _ in names[: 1 + kept]]
