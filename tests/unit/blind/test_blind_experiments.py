"""The experiments of the check on sealed cases, on small cases and answers made by hand."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind import experiments
from benchmarks.blind.experiments import Asked, asked, do_experiments, plan, resolving, tried
from benchmarks.blind.generator.cases import Spec
from benchmarks.blind.generator.experiment import AFTER, do
from benchmarks.blind.generator.generate import opaque, seal, write_case
from benchmarks.blind.judging import Judged, judge
from benchmarks.blind.records import Case
from benchmarks.blind.truth import TrueEffect, Truth
from orbitfb.physics.places import Ring

LADDER = {"kind": "bump-ladder", "splits": ["corrector-lag", "corrector-slew"], "amplitude": 0.02}
ADVICE = {"kind": "read-only-test", "splits": ["bpm-offset", "bpm-gain"], "amplitude": None}


def test_the_generator_of_experiments_knows_no_effect_of_the_library() -> None:
    code = (
        "import sys, benchmarks.blind.generator.experiment\n"
        "ours = [m for m in sys.modules if m.startswith('orbitfb.')]\n"
        "print(*(m for m in ours if not m.startswith(('orbitfb.physics', 'orbitfb.core'))))\n"
    )
    root = Path(__file__).parents[3]
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == []


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case with a slow corrector whose experiment moves two correctors."""
    folder = tmp_path_factory.mktemp("sealed")
    data, truth = folder / "data", folder / "truth"
    for each in (data, data / "later", truth, folder / "plans", folder / "new"):
        each.mkdir(parents=True)
    spec = Spec(
        effects=("corrector-lag",),
        target=12.0,
        planes="x",
        ring="first",
        dither="passive",
        ticks=250,
        later=0,
        seed=5,
        background=False,
    )
    write_case(spec, opaque(1, 0), data, truth, 1)
    seal(data, truth, "quick", 1)
    names = Ring.load().names("COR")
    np.savez(
        folder / "plans" / f"{opaque(1, 0)}.npz",
        waveform=np.array([[1e-3, 0.0], [-1e-3, 2e-3]]).repeat(20, axis=0),
        corr_names=np.array([names[7], names[3]]),
        planes=np.array(["x", "x"]),
        start_s=np.float64(3.0),
    )
    return folder


def test_an_experiment_is_the_same_machine_with_the_excitation(sealed: Path) -> None:
    name = opaque(1, 0)
    truth = json.loads((sealed / "truth" / f"{name}.json").read_text())
    file = sealed / "plans" / f"{name}.npz"
    (sealed / "out").mkdir()
    assert do(sealed / "out", sealed / "new", 1, file, truth) == ""
    with np.load(sealed / "out" / f"{name}.npz") as new:
        record = {key: new[key] for key in new.files}
    with np.load(sealed / "data" / f"{name}.npz") as old:
        np.testing.assert_array_equal(record["model_R"], old["model_R"])
        assert set(record) == set(old.files)
        assert not np.isin(record["orbit"], old["orbit"]).any()
    begin = round(3.0 / truth["period_s"])
    assert len(record["t"]) == begin + 40 + AFTER
    # The column `dither` holds the change of the excursion that is sent in a tick.
    stands = np.cumsum(record["dither"], axis=0)
    names = list(Ring.load().names("COR"))
    moved = np.zeros_like(stands)
    moved[begin - 1 : begin + 19, 7] = 1e-3
    moved[begin + 19 : begin + 39, 7] = -1e-3
    moved[begin + 19 : begin + 39, 3] = 2e-3
    assert len(names) == stands.shape[1]
    np.testing.assert_allclose(stands, moved, atol=1e-15)
    told = json.loads((sealed / "new" / f"{name}.json").read_text())
    assert told["effects"][0]["parameters"] == truth["effects"][0]["parameters"]
    assert told["planned_ticks"] == told["ticks"] == len(record["t"])


def test_a_case_that_comes_out_otherwise_is_refused(sealed: Path) -> None:
    name = opaque(1, 0)
    truth = json.loads((sealed / "truth" / f"{name}.json").read_text())
    truth["effects"][0]["parameters"]["tau"]["value"] *= 1.01
    (sealed / "other").mkdir()
    file = sealed / "plans" / f"{name}.npz"
    assert "changed since" in do(sealed / "other", sealed / "other", 1, file, truth)
    assert not list((sealed / "other").rglob("*.npz"))


def case(name: str, effect: str | None = "corrector-lag", known: bool = True) -> Case:
    effects = () if effect is None else (TrueEffect(effect, frozenset({effect}), known),)
    truth = Truth(effects, "easy" if effects else "none")
    return Case("own fast 1", name, Path(f"data/{name}.npz"), truth)


def test_only_ambiguous_answers_ask() -> None:
    one = case("a")
    told = asked(one, {"state": "ambiguous", "experiment": LADDER})
    assert told == Asked(one, "bump-ladder", ("corrector-lag", "corrector-slew"), True)
    advice = asked(one, {"state": "ambiguous", "experiment": ADVICE})
    assert advice == Asked(one, "read-only-test", ("bpm-offset", "bpm-gain"), False)
    assert asked(one, {"state": "named", "experiment": LADDER}) is None
    assert asked(one, None) is None


def test_a_plan_is_asked_for_as_an_operator_would(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[tuple[str, ...]] = []
    monkeypatch.setattr(experiments, "_run", lambda *words: said.append(words))
    plan(tmp_path, Asked(case("c"), "bump-ladder", ("corrector-lag", "corrector-slew"), True))
    wanted = f"orbitfb diagnose plan data/c.npz --for corrector-lag --out {tmp_path}/c.npz --json"
    assert " ".join(said[0]) == f"{wanted} --against corrector-slew"


def test_the_generator_does_what_was_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[str, ...]] = []

    def run(module: str, *arguments: str) -> bool:
        told.append((module, *arguments))
        return True

    monkeypatch.setattr(experiments, "_run", run)
    moving = Asked(case("a"), "bump-ladder", ("corrector-lag",), True)
    still = Asked(case("b"), "read-only-test", ("bpm-offset",), False)
    assert do_experiments([still], tmp_path, 1) == [(still, None)]
    assert not told
    assert do_experiments([moving, still], tmp_path, 1) == [(moving, None), (still, None)]
    assert [words[0] for words in told] == [
        "orbitfb",
        "benchmarks.blind.generator.experiment",
    ]
    assert told[1][told[1].index("--truth") + 1] == "data_truth"


def answer(one: Case, state: str, effect: str = "") -> Judged:
    causes = [{"effect": effect, "probability": 0.99}] if effect else []
    return judge(one.truth, {"state": state, "causes": causes})


def test_resolved_is_a_sure_name_of_the_very_effect(tmp_path: Path) -> None:
    told = [
        (case("right"), "named", "corrector-lag"),
        (case("kin"), "named", "corrector-slew"),
        (case("still"), "ambiguous", "corrector-lag"),
        (case("nothing", None), "no_gap", ""),
        (case("foreign", "x-new", known=False), "named", "corrector-lag"),
    ]
    found = []
    for one, state, effect in told:
        wanted = Asked(one, "bump-ladder", ("corrector-lag",), True)
        found.append(tried(wanted, one, tmp_path, answer(one, state, effect)))
    failed = Asked(case("failed"), "bump-ladder", ("corrector-lag",), True)
    found.append(tried(failed, None, tmp_path, None))
    (tmp_path / "undone.npz").touch()
    found.append(tried(Asked(case("undone"), "bump-ladder", ("a",), True), None, tmp_path, None))
    found.append(tried(Asked(case("advice"), "read", ("a",), False), None, tmp_path, None))
    assert [one.outcome for one in found[-3:]] == ["no plan", "not done", "no excitation"]
    known, others, apart = resolving(found)
    assert (known.hits, known.count) == (1, 4)
    assert (others.hits, others.count) == (1, 2)
    assert (apart.hits, apart.count) == (1, 8)
