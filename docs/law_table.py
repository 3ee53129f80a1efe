"""The table of all effects as the diagnosis knows them: a pattern times a course in time."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.simulate import simulate_record
from orbitfb.diagnose.verdict.proved import SCREENED
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import (
    DeviceLaw,
    ElementsLaw,
    EventLaw,
    FieldLaw,
    Law,
    PairLaw,
    RandomLaw,
    Signals,
)
from orbitfb.effects.registry import all_effects
from orbitfb.physics.places import Ring

HEAD = """# Effects as patterns and courses

How [the diagnosis](../explanations/diagnosis.md) knows every effect: a *pattern* over the BPMs
times a *course* in time, with the parameters that are fitted.

"""
_ROWS = 40
"""Of the record on which the laws are asked: no law needs more to say of what form it is."""

_ROUNDING = 1e-6
"""Change of a course, of its largest value, that is none [1]."""

_PATTERNS = {
    "bpm": "the BPM itself",
    "corrector": "column of R of the corrector",
    "quadrupole": "orbit of a kick in the quadrupole",
    "sextupole": "orbit of a kick in the sextupole",
    "source": "orbit of a kick at the place",
    "ring": "the whole ring",
}


def law_page(note: str) -> str:
    """Return the page.

    Args:
        note: Where the page comes from.
    """
    signals = _signals()
    rows = ["| effect | pattern | course | parameters |\n|---|---|---|---|\n"]
    for kind in all_effects().values():
        values = ", ".join(f"`{p.name}` [{p.unit}]" for p in kind.parameters) or "none"
        rows.append(
            f"| [`{kind.id}`](effects/{kind.id}.md) | {_PATTERNS[kind.target]} | "
            f"{_courses(kind, signals)} | {values} |\n"
        )
    return HEAD + note + "\n" + "".join(rows)


def _signals() -> Signals:
    """A record of both planes with every channel that an effect may follow."""
    record = simulate_record(Ring.load(), "xy", _ROWS, dither=1e-4)
    slow = np.linspace(0.0, 1.0, len(record))
    channels = {"current": 0.5 - 0.01 * slow, "rf": 5e8 + slow, "gap_id": 0.01 + 0.01 * slow}
    record = replace(record, auxiliary=channels)
    orbit = record.setpoints @ record.layout.response.T
    return Signals(record, record.setpoints, orbit)


def _courses(kind: EffectKind, signals: Signals) -> str:
    if kind.id in SCREENED:
        return "exact repeats, which the integrity screen proves"
    found = dict.fromkeys(word for law in kind.laws(signals) for word in _words(kind, law, signals))
    if not found:
        raise ValueError(f"{kind.id}: it has no law on a record with everything in it")
    return "; or ".join(found)


def _words(kind: EffectKind, law: Law, signals: Signals) -> Iterator[str]:
    match law:
        case DeviceLaw():
            if law.periodic:
                yield "a wave of any frequency"
            else:
                yield f"follows {_driver(kind, law, signals)}"
        case PairLaw():
            yield "the courses of two devices, mixed"
        case FieldLaw():
            yield "one orbit course of given values"
        case RandomLaw():
            yield _random(law)
        case ElementsLaw():
            yield "the setpoints, with a free element for each"
        case EventLaw():
            yield "a known change at every row" if law.often else "a known change at unknown rows"


def _driver(kind: EffectKind, law: DeviceLaw, signals: Signals) -> str:
    """What a course follows: what changes it when it changes."""
    if law.driven:
        return "the setpoints"
    values = {parameter.name: parameter.typical for parameter in kind.parameters}
    now = law.course(values, signals)
    record = signals.record
    without = {name: np.zeros_like(one) for name, one in record.auxiliary.items()}
    for other, word in (
        (replace(signals, orbit=0.5 * signals.orbit), "the predicted orbit"),
        (replace(signals, currents=0.5 * signals.currents), "the setpoints"),
        (replace(signals, record=replace(record, auxiliary=without)), "a logged channel"),
    ):
        then = law.course(values, other)
        if any(
            np.abs(a - b).max() > _ROUNDING * np.abs(a).max()
            for a, b in zip(now, then, strict=True)
        ):
            return word
    return "time"


def _random(law: RandomLaw) -> str:
    if law.lag:
        return f"noise that remembers {law.lag} row{'s' if law.lag > 1 else ''}"
    if law.smooth:
        return "smooth and random"
    if law.rare:
        return "few large strokes at unknown rows"
    if law.walk:
        return "a random walk"
    return "white noise"
