"""The file of effects (`effect.toml`): a fragment of the configuration with `[[effect]]` tables.

`orbitfb diagnose` writes it; `--effects FILE` of the commands that simulate a ring reads it, and
so does `--config FILE`, because its key is the configuration's.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from orbitfb.core.errors import ConfigError
from orbitfb.core.files.bounded import parse_toml, read_text
from orbitfb.effects.settings import EffectSettings, describe, read_effect

KEY = "effect"
_LARGEST = 1 << 20


def read_effects(path: Path) -> tuple[EffectSettings, ...]:
    """Read a file of effects; other keys of a configuration in it are not for here.

    Raises:
        ConfigError: It cannot be read, has something else in it, or an effect is wrong.
    """
    text = read_text(path, _LARGEST, ConfigError, "name a file of effects (TOML)")
    tree = parse_toml(text, path, ConfigError)
    others = sorted(set(tree) - {KEY})
    if others:
        raise ConfigError(
            f"{path}: {', '.join(others)} is not for a file of effects, which has [[effect]] "
            "tables alone; give a whole configuration with --config"
        )
    tables = tree.get(KEY, [])
    if not isinstance(tables, list):
        raise ConfigError(f"{path}: effect is not a list; write [[effect]] above each")
    return tuple(
        read_effect(table, f"{path}, effect {number}")
        for number, table in enumerate(tables, start=1)
    )


def effects_toml(effects: Sequence[EffectSettings], heading: str = "") -> str:
    """Write effects as TOML, each with what it means.

    Args:
        effects: Their settings.
        heading: Goes above them as a comment.
    """
    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    for its in effects:
        lines += ["", *_table(its)]
    return "\n".join(lines).lstrip("\n") + "\n"


def _table(its: EffectSettings) -> Iterator[str]:
    kind = its.kind
    yield f"# {kind.title}: {kind.sentence}".replace("\n", " ")
    yield f"[[{KEY}]]"
    yield f"id = {json.dumps(its.id)}"
    for key, items in (("cells", its.cells), ("names", its.names)):
        if items:
            yield f"{key} = {json.dumps(list(items), ensure_ascii=False)}"
    if its.planes != "xy":
        yield f"planes = {json.dumps(its.planes)}"
    if its.since:
        yield f"from = {its.since!r}  # s"
    if its.values:
        known = {p.name: p for p in kind.parameters}
        for name in its.values:
            yield f"# {describe(known[name])}: {known[name].description}".replace("\n", " ")
        pairs = ", ".join(f"{json.dumps(name)} = {value!r}" for name, value in its.values.items())
        yield f"values = {{ {pairs} }}"
    if its.elements:
        yield "# m/A"
        yield f"[{KEY}.elements]"
        yield from (f"{json.dumps(name)} = {error!r}" for name, error in its.elements.items())
