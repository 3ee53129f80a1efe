"""Write the reference pages from the code: `.venv/bin/python docs/generate.py`.

Every page has a function that returns its text; a test compares it with the file.
"""

import json
import re
from collections.abc import Callable, Iterator
from enum import Enum
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import typer
from pydantic.fields import FieldInfo

from docs.law_table import law_page
from orbitfb.cli.app import app
from orbitfb.config.tree import AppConfig
from orbitfb.core.settings import Settings
from orbitfb.core.signals import LoopState
from orbitfb.diagnose.result.diagnosis import schema as diagnosis_schema
from orbitfb.diagnose.result.schema_page import answer_page
from orbitfb.effects.pages import effect_page, effects_index
from orbitfb.effects.registry import all_effects
from orbitfb.loco.schema import schema as response_schema
from orbitfb.loop.fault_table.table import faults_markdown
from orbitfb.loop.states import COMMANDS, TABLE, Event
from orbitfb.observe.metrics.reference import metrics_table_markdown
from orbitfb.panel.pv_docs import panel_table_markdown
from orbitfb.panel.pv_table import Extent
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Planes, Ring
from orbitfb.sim.pv_table import count_pvs, pv_families, pv_table_markdown
from orbitfb.sim.settings import SimSettings

DOCS = Path(__file__).parent
NOTE = "This page is written by `.venv/bin/python docs/generate.py`; a test compares the two.\n"
PLANES: tuple[Planes, ...] = ("x", "y", "xy")

PVS_HEAD = """# PVs

The names are those of the machine and come from the places table (`ring.places`); the simulated
ring serves the same ones, so the loop cannot tell the two apart. Channel Access only, scalar
doubles, one PV per BPM and plane.

- Everything that clients only read is published once per tick, all of it with the same time
  stamp.
- A write beyond the limits, a write that is not finite, and a write to a reading are refused with
  an error to the client and change nothing.
- A write to a setpoint is in force from the next tick on; its readback shows it then.
- Positions are mm, corrector currents A, the stored current mA; inside orbitfb everything is SI.
- The simulated ring listens on 127.0.0.1, port 15064 (`sim.port`), not on the production port
  5064. A write to the kick PV moves the orbit at the next tick and the step stays; the stored
  current is what was last written to `SR:SIM{Ring}Current-SP`, from the next tick on.
- Besides, a text for each plane, `SR:FB{Lease:X}Owner-SP` and `SR:FB{Lease:Y}Owner-SP`, says which
  controller writes to it (`lease.pv`; see [Safety](../explanations/safety.md#two-controllers)).
- Further down: [the PVs of the panel](#the-panel), by which operators see and command the loop.

"""

PANEL_HEAD = """
## The panel

PVs of the loop itself, defined in `orbitfb/panel/pv_table.py`, served while `orbitfb run` runs with
`panel.enabled`; see [Operate by PVs](../how-to/operate-by-pvs.md). Their names begin with
`panel.prefix`, by default `SR:FB{Orbit}`, and they are served on `panel.interface`, port
`panel.port` (127.0.0.1, 15074).

- `-SP` is what is wanted, `-RB` what is in force, `-Cmd` does something once, `-I` is shown.
- A write beyond the limits, or one that the loop refuses, is an error to the client; it puts the PV
  in alarm (MAJOR, WRITE), leaves its value alone, and is logged. Nothing is ever clipped.
- A write is acknowledged (`caput -c`) when the service has done it, and shows in the `-RB` then.
- A value that is not known is INVALID. Texts are arrays of characters (`caget -S`).
- The table is that of a loop on x; with `--planes y` or `xy` there are `GainY-SP`, `GainY-RB` and
  `RmsY-I` as well or instead, and vectors have the length of both planes.

"""

CONFIGURATION_HEAD = """# Configuration

One TOML file (`--config FILE`), `ORBITFB_…` environment variables and options of the command
line; later ones win. `ORBITFB_LOOP__RATE_HZ=20` sets `loop.rate_hz`. Relative paths in the file are
seen from its directory, all others from the working directory. A key that nobody knows, a
wrong type or a value out of its bounds is refused with its path and the line where it stands.
`orbitfb config show` prints everything as TOML, `orbitfb config check FILE` checks a file,
`orbitfb config schema` prints the JSON schema, kept as [config.schema.json](config.schema.json).

Numbers are SI. "none" as a default means: leave the key out. With a `plant.drift.preset` the other
keys of `plant.drift` get the values of the preset unless they are given.

"""

CLI_HEAD = """# Command line

Any command takes `--help`. An error that orbitfb knows is one message without a traceback, and
exit code 2; `orbitfb run` exits with 1 when the loop ended in FAULT.

"""


def pvs_page() -> str:
    """Return the page of the PVs."""
    ring, settings = Ring.load(), SimSettings()
    parts = [PVS_HEAD, NOTE]
    for planes in PLANES:
        total = count_pvs(pv_families(ring, planes, settings))
        parts.append(f"\n## `--planes {planes}`: {total} PVs\n\n")
        parts.append(pv_table_markdown(ring, planes, settings))
    channels = ring.channels("x")
    extent = Extent.of(channels)
    parts += [PANEL_HEAD, panel_table_markdown(PanelSettings(), extent)]
    return "".join(parts)


def configuration_page() -> str:
    """Return the page of the configuration keys."""
    return CONFIGURATION_HEAD + NOTE + "".join(_sections(AppConfig, ""))


def _sections(model: type[Settings], table: str) -> Iterator[str]:
    fields = model.model_fields
    nested = {name: kind for name, field in fields.items() if (kind := _nested(field))}
    plain = [name for name in fields if name not in nested]
    heading = f"[{table}]" if table else "at the top"
    yield f"\n## `{heading}`\n\n" if table else f"\n## {heading}\n\n"
    yield f"{(model.__doc__ or '').splitlines()[0]}\n"
    if plain:
        yield "\n| key | type | default | bounds | unit | meaning |\n|---|---|---|---|---|---|\n"
    for name in plain:
        yield _key_row(name, fields[name])
    for name, kind in nested.items():
        yield from _sections(kind, f"{table}.{name}" if table else name)


def _nested(field: FieldInfo) -> type[Settings] | None:
    kind = field.annotation
    return kind if isinstance(kind, type) and issubclass(kind, Settings) else None


def _key_row(name: str, field: FieldInfo) -> str:
    meaning = field.description or ""
    unit = re.search(r"\[([^\]]+)\]", meaning)
    cells = (
        f"`{name}`",
        _type_name(field.annotation),
        _default(field.get_default(call_default_factory=True)),
        _bounds(field),
        unit.group(1) if unit else "",
        meaning,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _type_name(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return ", ".join(f"`{value}`" for value in get_args(kind))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return ", ".join(f"`{member.value}`" for member in kind)
    if get_origin(kind) is dict:
        key, value = get_args(kind)
        return f"table of {_type_name(key)} to {_type_name(value)}"
    if isinstance(kind, type) and issubclass(kind, Settings):
        fields = kind.model_fields.items()
        return "{ " + ", ".join(f.serialization_alias or name for name, f in fields) + " }"
    if get_origin(kind) is tuple:
        return f"list of {_type_name(get_args(kind)[0])}"
    members = [member for member in get_args(kind) if member is not NoneType]
    if members:
        return " or ".join(_type_name(member) for member in members)
    return {"float": "number", "int": "integer", "str": "text", "bool": "true/false"}.get(
        kind.__name__, kind.__name__.lower()
    )


def _default(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, dict):
        return ", ".join(f"`{key}`" for key in value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    return f"`{value}`" if str(value) else "empty"


def _bounds(field: FieldInfo) -> str:
    words = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥"}
    return ", ".join(
        f"{word} {getattr(limit, name):g}"
        for limit in field.metadata
        for name, word in words.items()
        if getattr(limit, name, None) is not None
    )


def schema_file() -> str:
    """Return the JSON schema as `orbitfb config schema` prints it."""
    return json.dumps(AppConfig.model_json_schema(), indent=2) + "\n"


def cli_page() -> str:
    """Return the page of the commands."""
    return CLI_HEAD + NOTE + "".join(_commands(typer.main.get_command(app), "orbitfb"))


def _commands(command: Any, name: str) -> Iterator[str]:
    children = dict(getattr(command, "commands", {}))
    yield f"\n## `{name}`\n\n{command.help}\n"
    if children:
        yield "\n" + "".join(
            f"- [`{name} {child}`](#{_anchor(f'{name} {child}')})\n" for child in children
        )
    shown = [p for p in command.params if not _is_completion(p)]
    if shown:
        yield "\n| argument or option | value | meaning |\n|---|---|---|\n"
    types = get_type_hints(command.callback) if shown else {}
    for parameter in shown:
        yield _parameter_row(parameter, _type_name(types[parameter.name]))
    for child in children.values():
        yield from _commands(child, f"{name} {child.name}")


def _anchor(heading: str) -> str:
    return heading.replace(" ", "-")


def _is_completion(parameter: Any) -> bool:
    return any("completion" in option for option in parameter.opts)


def _parameter_row(parameter: Any, kind: str) -> str:
    is_option = parameter.param_type_name == "option"
    names = ", ".join(parameter.opts) if is_option else parameter.name.upper()
    meaning = (parameter.help or "") + (" Required." if is_option and parameter.required else "")
    cells = (f"`{names}`", "" if kind == "true/false" else kind, meaning)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def states_table() -> str:
    """Return the state table: a row for every event, a column for every state."""
    rows = [
        "| event | " + " | ".join(f"in {state}" for state in LoopState) + " |",
        "|---" * (len(LoopState) + 1) + "|",
    ]
    for event in Event:
        cells = [TABLE[state].get(event) for state in LoopState]
        kind = "command" if event in COMMANDS else "event"
        shown = [
            "refused" if after is None else "stays" if after is state else f"→ **{after}**"
            for state, after in zip(LoopState, cells, strict=True)
        ]
        rows.append(f"| {kind} `{event}` | " + " | ".join(shown) + " |")
    return "\n".join(rows) + "\n"


def fill_marked(text: str, mark: str, content: str) -> str:
    """Replace what stands between `<!-- mark -->` and `<!-- end mark -->`.

    Args:
        text: The page.
        mark: Word of both comments.
        content: What to put between them.

    Raises:
        ValueError: The page has no such comments.
    """
    pattern = re.compile(rf"(<!-- {mark} -->\n).*?(<!-- end {mark} -->)", re.DOTALL)
    filled, count = pattern.subn(lambda found: found[1] + "\n" + content + "\n" + found[2], text)
    if count != 1:
        raise ValueError(f"the page has {count} places marked '{mark}', not one")
    return filled


def safety_page() -> str:
    """Return the safety page with its tables of states and faults renewed."""
    page = (DOCS / "explanations/safety.md").read_text(encoding="utf-8")
    page = fill_marked(page, "states", states_table())
    return fill_marked(page, "faults", faults_markdown())


PAGES: dict[str, Callable[[], str]] = {
    "reference/pvs.md": pvs_page,
    "reference/configuration.md": configuration_page,
    "reference/config.schema.json": schema_file,
    "reference/cli.md": cli_page,
    "reference/metrics.md": metrics_table_markdown,
    "explanations/safety.md": safety_page,
    "reference/diagnosis.md": partial(answer_page, NOTE),
    "reference/diagnosis.schema.json": diagnosis_schema,
    "reference/response-diagnosis.schema.json": response_schema,
    "reference/effects/index.md": partial(effects_index, NOTE),
    "reference/laws.md": partial(law_page, NOTE),
    **{f"reference/effects/{name}.md": partial(effect_page, name, NOTE) for name in all_effects()},
}
"""Every generated file below `docs/` and what makes it."""


def main() -> None:
    """Write every page; take away those of effects that are no more."""
    (DOCS / "reference/effects").mkdir(exist_ok=True)
    for page in (DOCS / "reference/effects").glob("*.md"):
        if f"reference/effects/{page.name}" not in PAGES:
            page.unlink()
    for name, make in PAGES.items():
        (DOCS / name).write_text(make(), encoding="utf-8")
        print(f"docs/{name}")


if __name__ == "__main__":
    main()
