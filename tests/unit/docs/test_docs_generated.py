"""Generated pages say what the code says."""

import json

import pytest
import typer

from orbitfb.cli.app import app
from orbitfb.config.tree import AppConfig
from orbitfb.core.settings import Settings
from orbitfb.core.signals import LoopState
from orbitfb.effects.registry import all_effects
from orbitfb.physics.places import Ring
from orbitfb.sim.layout import lay_out
from orbitfb.sim.pv_table import pv_families
from orbitfb.sim.settings import SimSettings

PAGES = (
    "reference/pvs.md",
    "reference/configuration.md",
    "reference/config.schema.json",
    "reference/cli.md",
    "reference/metrics.md",
    "explanations/safety.md",
    "reference/diagnosis.md",
    "reference/diagnosis.schema.json",
    "reference/response-diagnosis.schema.json",
    "reference/effects/index.md",
    "reference/laws.md",
    *(f"reference/effects/{name}.md" for name in all_effects()),
)


@pytest.mark.parametrize("name", PAGES)
def test_committed_page_is_what_the_generator_writes(generator, docs, name):
    assert (docs / name).read_text(encoding="utf-8") == generator.PAGES[name](), (
        f"docs/{name} is behind the code: run `.venv/bin/python docs/generate.py`"
    )


def test_every_generated_page_is_compared(generator):
    assert set(generator.PAGES) == set(PAGES)


def test_no_page_is_left_of_an_effect_that_is_no_more(docs):
    pages = {page.stem for page in (docs / "reference/effects").glob("*.md")}
    assert pages == {*all_effects(), "index"}


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_families_hold_every_pv_once(planes):
    ring, settings = Ring.load(), SimSettings()
    layout = lay_out(ring.channels(planes), settings)
    served = [*layout.readings, *layout.setpoints, *layout.knobs]
    families = pv_families(ring, planes, settings)
    assert sorted(s.name for f in families for s in f.specs) == sorted(s.name for s in served)
    written = {s.name for f in families if f.written for s in f.specs}
    assert written == {s.name for s in (*layout.setpoints, *layout.knobs)}


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_a_family_is_of_one_plane_and_shares_units_and_limits(planes):
    marks = {
        "BPM reading, x": "Pos:X-I",
        "BPM reading, y": "Pos:Y-I",
        "corrector setpoint, x": "Sp1-SP",
        "corrector setpoint, y": "Sp2-SP",
        "corrector readback, x": "Ps1DCCT1-I",
        "corrector readback, y": "Ps2DCCT1-I",
    }
    for family in pv_families(Ring.load(), planes, SimSettings()):
        mark = marks.get(family.meaning, "")
        assert all(spec.name.endswith(mark) for spec in family.specs), family.meaning
        assert len({(s.units, s.drive, s.warning, s.alarm) for s in family.specs}) == 1


def _keys(model, table=""):
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, Settings):
            yield from _keys(kind, f"{table}.{name}" if table else name)
        else:
            yield table, name


def test_every_configuration_key_stands_under_its_section(docs):
    found, table = set(), ""
    for line in (docs / "reference/configuration.md").read_text().splitlines():
        if line.startswith("## "):
            table = line.removeprefix("## ").strip("`[]").replace("at the top", "")
        elif line.startswith("| `"):
            found.add((table, line.split("`")[1]))
    assert found == set(_keys(AppConfig))


def test_every_key_is_explained(docs):
    for line in (docs / "reference/configuration.md").read_text().splitlines():
        if line.startswith("| `"):
            assert line.rstrip("| ").split(" | ")[-1].strip(), line


def test_schema_file_is_json_of_the_whole_tree(docs):
    schema = json.loads((docs / "reference/config.schema.json").read_text())
    assert set(schema["properties"]) == set(AppConfig.model_fields)


def test_every_command_has_a_section(docs):
    text = (docs / "reference/cli.md").read_text()

    def names(command, name):
        yield name
        for child in getattr(command, "commands", {}).values():
            yield from names(child, f"{name} {child.name}")

    for name in names(typer.main.get_command(app), "orbitfb"):
        assert f"\n## `{name}`\n" in text, name


def test_safety_page_names_every_state(docs):
    text = (docs / "explanations/safety.md").read_text()
    for state in LoopState:
        assert f"\n| {state} |" in text


def test_a_page_without_its_mark_is_refused(generator):
    with pytest.raises(ValueError, match="0 places marked 'states'"):
        generator.fill_marked("nothing here", "states", "table")
