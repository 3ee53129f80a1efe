"""Pages of the docs about the effects, from what every kind tells of itself."""

from collections.abc import Iterator
from functools import lru_cache
from typing import get_args

from orbitfb.effects.build import layout_of
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind, Parameter, Stage
from orbitfb.effects.places import names_for
from orbitfb.effects.registry import all_effects, effect
from orbitfb.physics.places import Planes, Ring
from orbitfb.records.layout import Layout

_PERIOD = 0.1
"""From one orbit to the next [s]; no place depends on it."""

_STAGES = {
    "sensor": "What BPMs make of the orbit.",
    "actuator": "What correctors make of their setpoints.",
    "optics": "What the magnets make of kicks.",
    "disturbance": "What moves the orbit besides the correctors.",
    "noise": "Randomness of the readings.",
    "timing": "When things happen.",
}
_TARGETS = {
    "bpm": "BPMs",
    "corrector": "correctors",
    "quadrupole": "quadrupoles",
    "sextupole": "sextupoles",
    "source": "places that kick the beam",
    "ring": "the whole ring",
}

_HEAD = """# Effects

Physical causes that the nominal simulator leaves out, and that `orbitfb diagnose` looks for. They
are switched on in the simulated ring one by one, each on some devices and from some time on:

```sh
orbitfb run --ioc sim --effect corrector-lag:tau=0.1s,cells=3-5,from=30s
```

After the id and a colon come its parameters (SI numbers, or with a unit: `50ms`, `2%`, `20um`) and
where it is: `cells=3-5+C07` or `names=PL1A_C01+PL2A_C01`, `planes=x`; without, everywhere.
Parameters that are left out are typical, as its page tells; the log of the start has all of them
(`effect_simulated`). A range of cells goes along the ring and may pass its beginning: `5-3` is all
but cell 4.
`from=30s` lets it begin later. `--effect` may be given again; a file of effects, as a diagnosis
writes it, goes to `--effects FILE`, or to `--config FILE`, where each is an `[[effect]]` table:

```toml
# effects.toml
[[effect]]
id = "corrector-lag"
cells = ["3-5"]
planes = "x"
from = 30.0
values = { tau = 0.1 }
```

`orbitfb effects` prints this list, `orbitfb effects show ID` one page. What a diagnosis
knows of each, a pattern over the BPMs times a course in time, is in [one table](../laws.md).

"""


def effects_index(note: str) -> str:
    """Return the page of all effects by stage.

    Args:
        note: Where the page comes from.
    """
    parts = [_HEAD, note]
    for stage in get_args(Stage):
        kinds = [kind for kind in all_effects().values() if kind.stage == stage]
        if kinds:
            parts.append(f"\n## {stage}\n\n{_STAGES[stage]}\n\n| effect | what it is | on |\n")
            parts.append("|---|---|---|\n")
        parts += [
            f"| [`{kind.id}`]({kind.id}.md) | {_cell(kind.title)} | {_TARGETS[kind.target]} |\n"
            for kind in kinds
        ]
    return "".join(parts)


def effect_page(name: str, note: str) -> str:
    """Return the page of one effect.

    Args:
        name: Its id.
        note: Where the page comes from.
    """
    return "\n".join(_page(effect(name), note)) + "\n"


def _page(kind: EffectKind, note: str) -> Iterator[str]:
    yield f"# {kind.id}\n\n{_capital(kind.title)}. {kind.sentence}\n\n{note}"
    yield f"Stage: {kind.stage} ([all effects](index.md)). On: {_TARGETS[kind.target]}.\n"
    yield f"```text\n{kind.equation}\n```\n"
    if kind.parameters:
        yield "| parameter | unit | bounds | none at | typical | meaning |"
        yield "|---|---|---|---|---|---|"
        yield from map(_row, kind.parameters)
        yield ""
    yield f"```sh\norbitfb run --ioc sim --effect {_example(kind)}\n```"
    if kind.confused_with:
        known = all_effects()
        links = [f"[{its}]({its}.md)" if its in known else its for its in kind.confused_with]
        told = f" To tell them apart: {kind.splits.rstrip('.')}." if kind.splits else ""
        yield f"\nA record may be unable to tell it from {', '.join(links)}.{told}"


def _row(p: Parameter) -> str:
    size = " (its order of magnitude)" if p.log else ""
    choices = "".join(f" {value:g}: {means}." for value, means in sorted(p.meanings.items()))
    return (
        f"| `{p.name}` | {p.unit} | {p.low:g} to {p.high:g} | {p.nominal:g} | {p.typical:g}{size} "
        f"| {_cell(p.description + choices)} |"
    )


def _example(kind: EffectKind) -> str:
    # A unit that begins with a digit, as 1/m, would run into the number.
    units = {p.name: "" if p.unit[:1].isdigit() else p.unit for p in kind.parameters}
    own = [p for p in kind.parameters if not p.optional]
    words = [f"{p.name}={p.typical:g}{units[p.name]}" for p in own]
    place, options = _where(kind)
    words += place
    return (f"{kind.id}:{','.join(words)}" if words else kind.id) + options


def _where(kind: EffectKind) -> tuple[list[str], str]:
    """Give the fewest devices that can have it, and the option of their planes.

    On all of them at once hardly any fault is one; randomness and time are common to all.
    """
    if kind.target == "ring" or kind.stage in ("noise", "timing"):
        return [], ""
    layout = _default_layout("x")
    if isinstance(kind, PairKind):
        options = "" if len(kind.pairs(layout)) else " --planes xy"
        layout = _default_layout("xy" if options else "x")
        names = names_for(kind, layout)
        pair = dict.fromkeys(names[int(column)] for column in kind.pairs(layout)[0])
        return ["names=" + "+".join(pair)], options
    return [f"names={names_for(kind, layout)[0]}"], ""


@lru_cache
def _default_layout(planes: Planes) -> Layout:
    return layout_of(Ring.load(), planes, _PERIOD)


def _capital(title: str) -> str:
    return title[:1].upper() + title[1:].rstrip(".")


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
