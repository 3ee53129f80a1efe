"""Records and truths of every form, read into one."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.records import left_out, read_folder, read_list
from benchmarks.blind.sources import SourceError, external
from benchmarks.blind.truth import TruthError, read_truth
from orbitfb.effects.registry import all_effects

OWN = {
    "spec": {},
    "ring": "first",
    "later_oracle_nats": 12.0,
    "effects": [
        {
            "effect": "corrector-lag",
            "stage": "actuator",
            "known": True,
            "places": ["CH1A_C30"],
            "parameters": {"tau": {"value": 0.05, "unit": "s"}},
            "d_prime": 11.0,
            "law": "mean",
        }
    ],
}
EXTERNAL = {
    "effects": [
        {
            "effect": "corrector_lag",
            "exotic": False,
            "localised": True,
            "stage": "actuator",
            "params": {"tau_s": 0.06, "cells": 2},
            "bpm_names": [],
            "corr_names": ["A", "B"],
        }
    ],
    "difficulty": "hard",
    "measured": {"shrink": 0.8},
}


def write(file: Path, told: dict) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(told))
    return file


def record(file: Path, bpms: tuple[str, ...] = ("P1",)) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez(file, bpm_names=np.array(bpms))


def test_the_truth_of_the_own_generator(tmp_path: Path) -> None:
    found = read_truth(write(tmp_path / "a.json", OWN))
    (effect,) = found.effects
    assert (found.level, found.kind, found.shrink, found.oracle_nats) == (
        "medium",
        "single",
        1.0,
        12.0,
    )
    assert {"corrector-lag", "corrector-slew"} < effect.accepted
    assert effect.parameters == {"tau": 0.05}
    noise = {**OWN, "effects": [{**OWN["effects"][0], "law": "random", "d_prime": 30.0}]}
    found = read_truth(write(tmp_path / "b.json", noise))
    assert (found.level, found.shrink) == ("easy", None)
    healthy = read_truth(write(tmp_path / "c.json", {**OWN, "effects": []}))
    assert (healthy.level, healthy.kind, healthy.title) == ("none", "none", "no gap")


def test_the_truth_of_an_external_generator(tmp_path: Path) -> None:
    found = read_truth(write(tmp_path / "a.json", EXTERNAL))
    (effect,) = found.effects
    assert (found.level, found.shrink) == ("hard", 0.8)
    assert (effect.accepted, effect.places) == ({"corrector-lag"}, {"A", "B"})
    assert effect.parameters == {"tau": 0.06}
    creep = {"effect": "corrector_creep", "localised": False, "params": {}}
    both = {**EXTERNAL, "effects": [EXTERNAL["effects"][0], creep]}
    assert read_truth(write(tmp_path / "b.json", both)).kind == "pair"
    alone = read_truth(write(tmp_path / "c.json", {**EXTERNAL, "effects": [creep]}))
    assert (alone.kind, alone.effects[0].accepted) == ("foreign", {"corrector-lag"})
    none = {"effects": [{"effect": "none"}], "difficulty": "null", "measured": {"shrink": None}}
    assert read_truth(write(tmp_path / "d.json", none)).kind == "none"


def test_a_word_that_nobody_translates_is_refused(tmp_path: Path) -> None:
    odd = {**EXTERNAL, "effects": [{"effect": "gremlin"}]}
    with pytest.raises(TruthError, match=r"a\.json: effect 'gremlin' is not in .*external\.toml"):
        read_truth(write(tmp_path / "a.json", odd))
    names = tmp_path / "names.toml"
    names.write_text('[known]\ngremlin = ["bpm-gain"]\n[foreign]\n[parameters]\n')
    found = read_truth(tmp_path / "a.json", names)
    assert found.effects[0].accepted == {"bpm-gain"}
    for text in ("[]", "{", '{"effects": 3}'):
        (tmp_path / "b.json").write_text(text)
        with pytest.raises(TruthError, match=r"b\.json: it is no truth of a record"):
            read_truth(tmp_path / "b.json")


def test_the_table_of_words_has_ids_of_the_library() -> None:
    import tomllib

    import benchmarks.blind.truth as module

    table = tomllib.loads(Path(module.__file__).with_name("external.toml").read_text())
    ids = {name for group in ("known", "foreign") for its in table[group].values() for name in its}
    assert ids - {"corrector-delay"} <= set(all_effects())


def test_a_folder_of_records(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    for name in ("a", "b"):
        record(folder / f"{name}.npz", (f"P_{name}",))
    record(folder / "later" / "b.npz")
    (folder / "other.csv").write_text("name,s\nP_b,1\n")
    (folder / "other.json").write_text("{}")
    write(tmp_path / "set_truth" / "a.truth.json", EXTERNAL)
    with pytest.raises(TruthError, match=r"b\.npz: no truth beside it"):
        read_folder(folder)
    write(tmp_path / "set_truth" / "b.json", OWN)
    one, other = read_folder(folder)
    assert (one.name, one.later, one.ring) == ("a", None, None)
    assert other.later == folder / "later" / "b.npz"
    assert other.ring == (folder / "other.csv", folder / "other.json")
    assert [case.name for case in read_folder(folder, chosen=["b"])] == ["b"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(TruthError, match="no record"):
        read_folder(tmp_path / "empty")


def test_a_list_of_records_of_one_truth(tmp_path: Path) -> None:
    record(tmp_path / "healthy.npz")
    record(tmp_path / "odd.npz")
    file = tmp_path / "cases.toml"
    file.write_text(
        '[[case]]\nrecord = "healthy.npz"\naccepted = []\nstates = ["unknown"]\n'
        '[[case]]\nrecord = "odd.npz"\naccepted = ["bpm-gain"]\ndevices = ["P1"]\nlevel = "hard"\n'
    )
    healthy, odd = read_list(file)
    assert (healthy.truth.kind, healthy.truth.states) == ("none", ("unknown",))
    assert (odd.truth.kind, odd.truth.level) == ("single", "hard")
    assert odd.truth.effects[0].places == {"P1"}
    for text, words in (
        ('[[case]]\nrecord = "gone.npz"\naccepted = []\n', r"gone\.npz is not there"),
        ('[[case]]\nrecord = "odd.npz"\n', r"cases\.toml: it is no list of cases"),
        ('[[case]]\nrecord = "odd.npz"\naccepted = "bpm-gain"\n', "is no list"),
    ):
        file.write_text(text)
        with pytest.raises(TruthError, match=words):
            read_list(file)


def test_what_can_be_seen_is_asked_once_more_without_its_effect(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    truths = {"a": OWN, "b": EXTERNAL, "c": {**OWN, "effects": []}}
    for name, told in truths.items():
        record(folder / f"{name}.npz")
        write(tmp_path / "set_truth" / f"{name}.json", told)
    (found,) = left_out(read_folder(folder))  # the other one is hard, the last one has none
    assert (found.name, found.without) == ("a", ("corrector-lag",))
    assert found.truth.kind == "foreign"
    assert "corrector-lag" not in found.truth.effects[0].accepted
    assert "corrector-slew" in found.truth.effects[0].accepted


def test_an_external_generator_that_is_absent_or_broken_says_so(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"there is no generate\.py"):
        external(tmp_path / "gone", tmp_path, 1, 2, 1, None)
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "generate.py").write_text("")
    with pytest.raises(SourceError, match="it does not run: ImportError"):
        external(broken, tmp_path, 1, 2, 1, None)


def test_an_external_generator_is_asked_case_by_case(tmp_path: Path) -> None:
    package = tmp_path / "maker"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "cases.py").write_text("def n_cases(): return 5\n")
    (package / "generate.py").write_text(
        "import json, sys, pathlib, numpy as np\n"
        "told = dict(zip(sys.argv[1::2], sys.argv[2::2]))\n"
        "out, name = pathlib.Path(told['--out']), f\"case_{int(told['--case']):03d}\"\n"
        "truth = out.with_name(out.name + '_truth')\n"
        "out.mkdir(exist_ok=True, parents=True); truth.mkdir(exist_ok=True)\n"
        "np.savez(out / f'{name}.npz', bpm_names=np.array([told['--seed']]))\n"
        f"text = {json.dumps(EXTERNAL)!r}\n"
        "(truth / f'{name}.truth.json').write_text(text)\n"
    )
    found = external(package, tmp_path / "out", 30, 2, 2, None)
    assert len(found) == 2
    for case in found:
        with np.load(case.record) as arrays:
            assert int(arrays["bpm_names"][0]) == 30 + int(case.name[-3:])
    assert [case.name for case in external(package, tmp_path / "out", 30, 2, 1, None)] == [
        case.name for case in found
    ]
