"""What the screen is certain of does not hide what else is wrong."""

from types import SimpleNamespace

from orbitfb.diagnose.engine import _taken_back
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
KINDS = [effect(name) for name in ("bpm-gain", "corrector-gain", "corrector-stuck")]


def found(*texts: str) -> tuple[str, ...]:
    effects = build([parse_effect(text) for text in texts], LAYOUT, 1)
    record = simulate_record(RING, "x", 500, 5, effects, dither=1e-3, gain=0.01)
    outcome = search(record, KINDS, given=(Cause(effect("bpm-polarity"), (30,), {}),))
    return tuple(cause.kind.id for cause in outcome.causes)


def test_a_gain_beside_a_reversed_bpm_is_named_too():
    reversed_bpm = f"bpm-polarity:names={LAYOUT.bpms.names[30]}"
    weak = f"corrector-gain:gain=0.3,names={LAYOUT.correctors.names[90]}"
    assert found(reversed_bpm, weak) == ("bpm-polarity", "corrector-gain")
    assert found(reversed_bpm) == ("bpm-polarity",)


def test_a_sign_that_is_turned_back_was_never_wrong():
    polarity = effect("bpm-polarity")
    given = (Cause(polarity, (30,), {}),)

    def outcome(place):
        entry = SimpleNamespace(kind=polarity, cause=Cause(polarity, (place,), {}))
        return SimpleNamespace(winners=(SimpleNamespace(accepted=entry),))

    assert _taken_back(given, outcome(30))
    assert not _taken_back(given, outcome(31))
    assert not _taken_back((), outcome(30))
