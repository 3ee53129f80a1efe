"""The reference page of `diagnosis.json`, made from its schema."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from orbitfb.diagnose.result.diagnosis import SCHEMA_VERSION, schema

_HEAD = f"""# diagnosis.json

`orbitfb diagnose` writes this file. The version is {SCHEMA_VERSION}; there is a
[JSON schema](diagnosis.schema.json). The first number of the version rises when a key goes or
changes its meaning, the second when a key is added.
`orbitfb.diagnose.result.diagnosis.read_diagnosis` reads the file.

- Numbers are finite. `null` means: not resolved, or not computed.
- Intervals are 90 %. In `gap`, `low` and `high` belong to `nats_per_tick`; in `shrink`, they belong
  to `nats`. `um_low` and `um_high` belong to `um`.
- `shrink` has shares: 1 is all of the gap; a negative share means that the gap has grown.
- `state` is `null` if the integrity screen failed (exit code 3). Then nothing was estimated, and
  `findings` says why.
- A device that acts in both planes is written as `NAME (x)` and `NAME (y)`. In a record of one
  plane it has only its name.

"""


def answer_page(note: str) -> str:
    """Write the page.

    Args:
        note: Says that the page is generated.
    """
    content = json.loads(schema())
    parts = content.pop("$defs")
    pieces = [_HEAD, note, *_section("At the top", content)]
    for name in _reached(content, parts):
        pieces += _section(f"`{name}`", parts[name])
    return "".join(pieces)


def _reached(node: Any, parts: Mapping[str, Any]) -> list[str]:
    """Names of parts in the order in which a reader meets them."""
    order: dict[str, None] = {}
    waiting = list(_references(node))
    while waiting:
        name = waiting.pop(0)
        if name not in order:
            order[name] = None
            waiting += _references(parts[name])
    return list(order)


def _references(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        if "$ref" in node:
            yield node["$ref"].rsplit("/", 1)[1]
        for value in node.values():
            yield from _references(value)
    elif isinstance(node, list):
        for value in node:
            yield from _references(value)


def _section(title: str, node: Mapping[str, Any]) -> Iterator[str]:
    yield f"\n## {title}\n\n{node.get('description', '')}\n\n"
    yield "| key | type | meaning |\n|---|---|---|\n"
    for key, its in node["properties"].items():
        cells = (f"`{key}`", _type(its), its.get("description", ""))
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _type(node: Mapping[str, Any]) -> str:
    if "$ref" in node:
        name = node["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in node:
        return " or ".join(_type(one) for one in node["anyOf"])
    if "const" in node:
        return f"`{node['const']}`"
    if "enum" in node:
        return ", ".join(f"`{value}`" for value in node["enum"])
    kind = str(node.get("type", ""))
    if kind == "array":
        if "prefixItems" in node:
            return "pair of " + _type(node["prefixItems"][0])
        return f"list of {_type(node['items'])}"
    if kind == "object":
        return f"table of {_type(node['additionalProperties'])}"
    words: dict[str, str] = {"boolean": "true/false", "string": "text", "null": "null"}
    return words.get(kind, kind)
