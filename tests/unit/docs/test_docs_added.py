"""The pages that tell how to extend orbitfb: their files, installed beside it, do what is said.

A package is installed by its metadata alone, in a folder of the test: nothing of the environment
changes.
"""

import dataclasses
import importlib
import re
import sys
import tomllib
from unittest.mock import Mock

import numpy as np
import pytest
from docs_pieces import ROOT, pieces

from orbitfb.cli.app import app
from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError
from orbitfb.effects.registry import all_effects
from orbitfb.learn.builders import builder, first_policy
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.masking import mask_of
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.store.kinds import added_kinds, all_kinds, kind_of

FILE = re.compile(r"^# ([\w.]+)\n")
READ_ONCE = (all_effects, added_kinds, all_kinds)


def files_of(page):
    """The files that a page shows, by the name in their first line."""
    text = (ROOT / "docs/how-to" / page).read_text(encoding="utf-8")
    blocks = [piece.body for piece in pieces(text) if piece.kind in ("python", "toml")]
    return {found[1]: body for body in blocks if (found := FILE.match(body))}


def install(folder, page):
    """Write the files of a page into a folder and make it a place of installed packages."""
    for name, body in files_of(page).items():
        (folder / name).write_text(body)
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    metadata = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    points = [
        f"[{group}]\n" + "".join(f"{name} = {where}\n" for name, where in entries.items())
        for group, entries in project["entry-points"].items()
    ]
    (metadata / "entry_points.txt").write_text("\n".join(points))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of installed packages, read anew by all that read entry points once."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    for cached in READ_ONCE:
        cached.cache_clear()
    yield tmp_path
    for cached in READ_ONCE:
        cached.cache_clear()
    for name in set(sys.modules) - before:
        if name.removeprefix("test_").startswith("my_"):
            del sys.modules[name]


def point(folder, group, name, where):
    """Let the package name something else."""
    [points] = folder.glob("*.dist-info/entry_points.txt")
    points.write_text(f"[{group}]\n{name} = {where}\n")


@pytest.mark.parametrize(
    ("page", "module"),
    [("add-an-effect.md", "test_my_effects"), ("write-a-policy.md", "test_my_policies")],
)
def test_the_test_of_the_page_passes(folder, page, module):
    install(folder, page)
    content = vars(importlib.import_module(module))
    [test] = [item for name, item in content.items() if name.startswith("test_")]
    test()


def test_the_effect_is_known_to_the_program(folder, capsys):
    install(folder, "add-an-effect.md")
    app(["effects", "show", "corrector-curvature"], standalone_mode=False)
    shown = capsys.readouterr().out
    assert shown.startswith("corrector-curvature: bent characteristic of a corrector\n")


def test_the_policy_can_be_configured_stored_and_refitted(folder):
    install(folder, "write-a-policy.md")
    settings = load_config(folder / "gentle.toml").policy
    ring = Ring.load()
    matrix = response(ring, "x")
    policy = first_policy(matrix, settings)
    assert policy.settings.gain == 0.5
    store = PolicyStore(folder / "store")
    store.save(policy, ring.channels("x"))
    back = store.load(policy.policy_id, ring.channels("x"))
    valid = np.ones(len(matrix), dtype=bool)
    error = np.linspace(-1e-6, 1e-6, len(valid))
    assert np.array_equal(policy.act(error, valid, None)[0], back.act(error, valid, None)[0])
    movable = np.arange(matrix.shape[1]) != 3
    masked = first_policy(matrix, settings, movable)
    assert masked.act(error, valid, None)[0][3] == 0.0
    assert kind_of(masked)[0].word == "gentle"
    model = Mock(response=1.01 * matrix)
    candidate = builder(settings, movable)(model, policy)
    assert candidate.policy_id.startswith("gentle-") and candidate.policy_id != policy.policy_id


def test_the_ring_of_the_page_is_a_good_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = files_of("describe-a-ring.md")
    exec(compile(files["make_ring.py"], "make_ring.py", "exec"), {})
    (tmp_path / "ring.toml").write_text(files["ring.toml"])
    config = load_config(tmp_path / "ring.toml")
    ring = config.ring.load()
    counting, _ = mask_of(ring.channels("xy"), config.masks)
    assert response(ring, "xy").shape == (48, 48)
    assert list(np.flatnonzero(~counting)) == [6, 30]


def test_what_contributors_are_told_to_run_is_there():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    targets = set(re.findall(r"make (\w+)", text))
    assert targets <= set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    paths = re.findall(r"tests/[\w/.]+", text)
    assert paths and all((ROOT / path).exists() for path in paths)


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (
            "my_effects:Missing",
            r"entry point corrector-curvature \(orbitfb.effects\) of the package my-effects "
            "cannot be loaded: AttributeError.*repair or uninstall",
        ),
        ("my_effects:np", "is module, expected was type"),
        ("my_effects:_Bent", "_Bent is no EffectKind"),
        ("my_effects:ActuatorKind", "ActuatorKind does not define drive, simulate"),
    ],
)
def test_an_effect_that_cannot_be_used_is_refused_in_a_sentence(folder, where, words):
    install(folder, "add-an-effect.md")
    point(folder, "orbitfb.effects", "corrector-curvature", where)
    with pytest.raises(ConfigError, match=words):
        all_effects()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"id": "bpm-gain"}, "there is an effect bpm-gain already"),
        ({"id": "Bent!"}, "'Bent!' is no id"),
    ],
)
def test_an_effect_has_an_id_of_its_own(folder, change, words):
    install(folder, "add-an-effect.md")
    module = importlib.import_module("my_effects")
    module.Other = type("Other", (module.CorrectorCurvature,), change)
    point(folder, "orbitfb.effects", "other", "my_effects:Other")
    with pytest.raises(ConfigError, match=words):
        all_effects()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("svd", {"word": "svd"}, "there is a kind of policy svd already"),
        ("other", {}, "its kind is called 'gentle'"),
        ("gentle", {"begin": None}, "has no `begin`"),
    ],
)
def test_a_policy_has_a_name_of_its_own(folder, name, change, words):
    install(folder, "write-a-policy.md")
    module = importlib.import_module("my_policies")
    module.OTHER = dataclasses.replace(module.GENTLE, **change)
    point(folder, "orbitfb.policies", name, "my_policies:OTHER")
    with pytest.raises(ConfigError, match=words):
        added_kinds()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "gentle"\n[policy.own]\ngian = 0.5\n', "gian"),
        ('kind = "gentel"\n', "there is no kind of policy 'gentel'"),
        ('kind = "svd"\n[policy.own]\ngain = 0.5\n', "svd has keys of its own"),
    ],
)
def test_settings_that_the_kind_does_not_know_are_refused(folder, text, words):
    install(folder, "write-a-policy.md")
    (folder / "wrong.toml").write_text(f"[policy]\n{text}")
    with pytest.raises(ConfigError, match=words):
        load_config(folder / "wrong.toml")
