"""The named devices as effects of a simulated ring, for `run --ioc sim --effects`."""

from collections.abc import Iterator, Sequence

from orbitfb.core.errors import ConfigError
from orbitfb.effects.files import effects_toml
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import EffectSettings, read_effect
from orbitfb.loco.run import Result
from orbitfb.loco.schema import Finding

_VALUES = {
    "bpm-gain": "gain",
    "corrector-gain": "gain",
    "bpm-roll": "angle",
    "corrector-roll": "angle",
    "skew-coupling": "skew",
}
"""Parameter of an effect that the size of a finding is."""

_PLAIN = ("bpm-polarity", "corrector-polarity", "bpm-swap", "corrector-swap")


def fragment(findings: Sequence[Finding], result: Result, headline: str) -> str:
    """Write the effects that make a simulated ring answer as the measured one does.

    A device that is dead, and a row that is not of the lattice, are no effect; they are left out.

    Args:
        findings: What stands out.
        result: Of the fit, for the strengths of the quadrupoles.
        headline: Above the file.
    """
    return effects_toml(
        tuple(_settings(findings, result)), f"orbitfb diagnose of a response\n{headline}"
    )


def _settings(findings: Sequence[Finding], result: Result) -> Iterator[EffectSettings]:
    strength = dict(zip(result.ring.names("QUAD"), result.optics.strength.tolist(), strict=True))
    for its in findings:
        if not its.named:
            continue
        names = [place.rpartition(":")[0] or place for place in its.places]
        plane = its.places[0].rpartition(":")[2] if ":" in its.places[0] else "xy"
        size = its.value or 0.0
        if its.kind in _PLAIN:
            table = _table(its.kind, names, plane, {})
        elif its.kind == "bpm-roll":
            # a reading of y sees −sin φ of x, one of x + sin φ of y
            table = _table(its.kind, names, "xy", {"angle": -size if plane == "y" else size})
        elif its.kind == "corrector-roll":
            table = _table(its.kind, names, plane, {"angle": size if plane == "x" else -size})
        elif its.kind == "quadrupole-gradient":
            table = _table(its.kind, names, "xy", {"gradient": size * strength[names[0]]})
        elif its.kind in _VALUES:
            planes = "xy" if its.kind == "skew-coupling" else plane
            table = _table(its.kind, names, planes, {_VALUES[its.kind]: size})
        else:
            continue
        try:
            yield read_effect(table, its.kind)
        except ConfigError:
            continue  # the device is beyond what the simulator can have; it is in the answer


def _table(kind: str, names: list[str], planes: str, values: dict[str, float]) -> dict[str, object]:
    known = {p.name: p for p in effect(kind).parameters}
    inside = {
        name: min(max(value, known[name].low), known[name].high)
        for name, value in values.items()
        if name in known
    }
    table: dict[str, object] = {"id": kind, "names": names, "values": inside}
    if planes != "xy":
        table["planes"] = planes
    return table
