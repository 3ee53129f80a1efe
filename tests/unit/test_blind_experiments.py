"""The experiments of the check on sealed cases, on small cases and answers made by hand."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from orbitfb.cli import blind_experiments, blind_processes
from orbitfb.cli.app import app
from orbitfb.cli.blind_experiments import Asked, asked, plan
from orbitfb.cli.blind_processes import Ended
from orbitfb.physics.places import Ring
from tests.blind.cases import Spec
from tests.blind.experiment import AFTER, do
from tests.blind.generate import opaque, seal, write_case
from tests.blind.judging import Order
from tests.blind.resolving import experiments_table, read_tried, resolving

LADDER = {
    "kind": "bump-ladder",
    "splits": ["corrector-lag", "corrector-slew"],
    "amplitude": 0.02,
    "minutes": 0.1,
}


def write_answer(
    folder: Path, state: str, effect: str = "", experiment: dict | None = None
) -> None:
    folder.mkdir(parents=True)
    causes = [{"effect": effect, "probability": 0.99, "places": []}] if effect else []
    answer = {"state": state, "causes": causes, "experiment": experiment}
    (folder / "diagnosis.json").write_text(json.dumps(answer), encoding="utf-8")


def test_the_generator_of_experiments_knows_no_effect_of_the_library() -> None:
    code = (
        "import sys, tests.blind.experiment\n"
        "ours = [m for m in sys.modules if m.startswith('orbitfb.')]\n"
        "print(*(m for m in ours if not m.startswith(('orbitfb.physics', 'orbitfb.core'))))\n"
    )
    root = Path(__file__).parents[2]
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == []


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case with a slow corrector whose experiment moves two correctors."""
    folder = tmp_path_factory.mktemp("sealed")
    data, truth = folder / "data", folder / "truth"
    for each in (data / "records", data / "later", truth, folder / "plans", folder / "new"):
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
    (sealed / "out" / "records").mkdir(parents=True)
    assert do(sealed / "out", sealed / "new", 1, file, truth) == ""
    with np.load(sealed / "out" / "records" / f"{name}.npz") as new:
        record = {key: new[key] for key in new.files}
    with np.load(sealed / "data" / "records" / f"{name}.npz") as old:
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
    (sealed / "other" / "records").mkdir(parents=True)
    file = sealed / "plans" / f"{name}.npz"
    assert "changed since" in do(sealed / "other", sealed / "other", 1, file, truth)
    assert not list((sealed / "other").rglob("*.npz"))


def test_only_ambiguous_answers_ask(tmp_path: Path) -> None:
    write_answer(tmp_path / "a", "ambiguous", "corrector-lag", LADDER)
    write_answer(tmp_path / "b", "named", "corrector-lag")
    advice = {"kind": "read-only-test", "splits": ["bpm-offset", "bpm-gain"], "amplitude": None}
    write_answer(tmp_path / "c", "ambiguous", "bpm-offset", advice)
    assert list(asked(tmp_path)) == [
        Asked("a", "bump-ladder", ("corrector-lag", "corrector-slew"), True),
        Asked("c", "read-only-test", ("bpm-offset", "bpm-gain"), False),
    ]


def test_a_plan_is_asked_for_as_an_operator_would(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[tuple[str, ...]] = []

    def fake(*arguments: str) -> Ended:
        said.append(arguments)
        return Ended(0, 1.0, json.dumps({**LADDER, "file": "somewhere"}), "")

    monkeypatch.setattr(blind_experiments, "command", fake)
    plan(tmp_path, tmp_path, Asked("c", "bump-ladder", ("corrector-lag", "corrector-slew"), True))
    wanted = f"diagnose plan {tmp_path}/records/c.npz --for corrector-lag --out {tmp_path}/c.npz"
    assert " ".join(said[0]) == f"{wanted} --against corrector-slew --json"
    assert json.loads((tmp_path / "c.json").read_text())["moves"]
    plan(tmp_path, tmp_path, Asked("d", "read-only-test", ("bpm-offset",), False))
    assert len(said) == 1
    assert not json.loads((tmp_path / "d.json").read_text())["moves"]


def truth_of(case: str, effect: str | None) -> dict:
    effects = []
    if effect:
        effects.append(
            {
                "effect": effect,
                "stage": "actuator",
                "known": not effect.startswith("x-"),
                "places": [],
                "parameters": {},
                "d_prime": 20.0,
                "oracle_nats": 200.0,
            }
        )
    times = {"ticks": 100, "planned_ticks": 120}
    return {"case": case, "effects": effects, "ring": "first", "dither": "passive", **times}


def test_resolved_is_a_sure_name_of_the_very_effect(tmp_path: Path) -> None:
    asked_for = {
        "right": ("corrector-lag", "named", "corrector-lag"),
        "kin": ("corrector-lag", "named", "corrector-slew"),
        "still": ("corrector-lag", "ambiguous", "corrector-lag"),
        "nothing": (None, "no_gap", ""),
        "failed": ("corrector-lag", "", ""),
        "advice": ("bpm-offset", "", ""),
    }
    plans, new = tmp_path / "plans", tmp_path / "truth"
    for folder in (plans, new):
        folder.mkdir()
    truths = []
    for case, (true, state, named) in asked_for.items():
        truths.append(truth_of(case, true))
        told = {
            "exit": 2 if case == "failed" else 0,
            "kind": "read-only-test" if case == "advice" else "bump-ladder",
            "splits": ["corrector-lag", "corrector-slew"],
            "moves": case != "advice",
        }
        (plans / f"{case}.json").write_text(json.dumps(told), encoding="utf-8")
        if state:
            (new / f"{case}.json").write_text(json.dumps(truths[-1]), encoding="utf-8")
            write_answer(tmp_path / "answers" / case, state, named)
    seal(tmp_path, new, "quick", 1)
    tried = read_tried(tmp_path, [*truths, truth_of("sure", None)], {"first": Order(Ring.load())})
    known, others, apart = resolving(tried)
    assert (known.value, known.count) == (0.25, 4)
    assert known.low == pytest.approx(0.0456, abs=1e-3)  # Wilson, 1 of 4
    assert (others.value, others.count) == (1.0, 1)
    assert (apart.value, apart.count) == (pytest.approx(1 / 6), 6)
    table = experiments_table(tried)
    assert "not tried: read-only-test 1." in table
    assert "interlock: 4." in table
    assert table.count("| yes |") == 2


@pytest.mark.parametrize("flag", ["--experiments", "--no-experiments"])
def test_the_command_does_them_unless_told_not_to(
    flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modules: dict[str, tuple[str, ...]] = {}
    done: list[Path] = []

    def module(source: Path, name: str, *arguments: str, quiet: bool = False) -> str:
        modules[name] = arguments
        return ""

    def do_them(*arguments: Path | int) -> None:
        done.append(Path(str(arguments[4])))

    monkeypatch.setattr(blind_processes, "module", module)
    monkeypatch.setattr(blind_experiments, "do_experiments", do_them)
    told = ["diagnose", "blind", "--out", str(tmp_path / "out"), "--no-baselines", flag]
    assert CliRunner().invoke(app, told).exit_code == 0
    wanted = tmp_path / "out" / "experiments"
    assert done == ([wanted] if flag == "--experiments" else [])
    assert (str(wanted) in modules["tests.blind.score"]) == bool(done)
    assert "tests.blind.baselines" not in modules
