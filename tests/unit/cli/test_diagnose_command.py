"""`orbitfb diagnose`: what it writes, how it ends, what it refuses."""

import json
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError, RecordError
from orbitfb.diagnose.report import writing
from orbitfb.diagnose.result import parts
from orbitfb.diagnose.result.diagnosis import read_diagnosis
from orbitfb.diagnose.screen import companion
from orbitfb.diagnose.verdict import files
from orbitfb.effects.build import layout_of
from orbitfb.effects.files import read_effects
from orbitfb.effects.places import resolve
from orbitfb.physics.places import Ring
from orbitfb.records.finding import Finding
from tests.unit.records import record_files
from tests.unit.result import examples


@pytest.fixture
def engine(monkeypatch):
    """What reads, screens and estimates, with answers to be chosen."""
    its = SimpleNamespace(answer=examples.named(), findings=(), noticed=(), calls=[])

    def diagnose(record, reference, holdout, *, seed, without, findings, progress):
        progress("scanning", 0.5)
        its.calls.append((record, reference, holdout, seed))
        return its.answer

    layout = SimpleNamespace(bpms="ab", correctors="a", planes=("x",), period=0.1)
    layout.response = np.ones((2, 1))

    class Record(SimpleNamespace):
        def __len__(self):
            return 7

    def load(path, **_):
        if not path.exists():
            raise RecordError(f"{path}: cannot be read")
        record = Record(name=path.name, layout=layout, digest="aa", source=str(path))
        record.readings = record.setpoints = np.full((7, 2), float(len(path.stem)))
        return SimpleNamespace(record=record, findings=its.noticed)

    its.page = writing.page  # some seconds of pictures: one test looks at them
    monkeypatch.setattr(writing, "page", lambda diagnosis: "<html></html>")
    monkeypatch.setattr(files, "diagnose", diagnose)
    for name in ("without_runaway", "without_spikes"):
        monkeypatch.setattr(files, name, lambda record: (record, []))
    for module in (files, companion):
        monkeypatch.setattr(module, "load", load)
        monkeypatch.setattr(module, "screen", lambda record: its.findings)
    return its


@pytest.fixture
def record(tmp_path):
    path = tmp_path / "shift.npz"
    path.write_bytes(b"")
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["diagnose", *map(str, arguments)])


def finding(severity):
    return Finding("readback-differs", severity, ("COR04",), (3, 9), "the readback stays")


@pytest.mark.nightly
def test_a_record_is_answered_with_its_files_beside_it(engine, record, tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "page", engine.page)
    result = run(record, "--seed", 3)
    assert result.exit_code == 0, result.output
    assert "named: Lag of a corrector on cells C04-C06" in result.stdout
    assert "corrector-lag" in result.stdout
    out = tmp_path / "shift.diagnosis"
    assert {path.name for path in out.iterdir()} == {
        "diagnosis.json",
        "report.html",
        "gap.csv",
        "effect.toml",
    }
    assert "<svg " in (out / "report.html").read_text(encoding="utf-8")
    assert read_diagnosis(out / "diagnosis.json").state == "named"
    assert engine.calls[0][1:] == (None, None, 3)


def test_a_cause_stands_in_one_line_where_there_is_no_terminal(engine, record):
    cause = examples.lag_cause().model_copy(update={"alternatives": ("corrector-slew",)})
    engine.answer = examples.named(causes=(cause,))
    lines = run(record).stdout.splitlines()
    (row,) = (line for line in lines if line.startswith("cause: "))
    assert "tau 93 [88, 98] ms" in row
    assert row.endswith("(corrector-lag)")
    assert "  It may also be corrector-slew." in lines


def test_the_word_record_may_be_typed_and_options_may_come_first(engine, record, tmp_path):
    assert run("record", record).exit_code == 0
    assert run("--out", tmp_path / "here", record).exit_code == 0
    assert (tmp_path / "here/diagnosis.json").exists()


def test_reference_and_later_record_reach_the_engine(engine, record, tmp_path):
    quiet, later = tmp_path / "quiet1.npz", tmp_path / "later12.npz"
    quiet.write_bytes(b"")
    later.write_bytes(b"")
    options = ("--reference", quiet, "--holdout", later)
    assert run(record, *options).exit_code == 0
    assert [its.name for its in engine.calls[0][:3]] == [
        "shift.npz",
        "quiet1.npz",
        "later12.npz",
    ]


@pytest.mark.parametrize("option", ["--reference", "--holdout"])
@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda made: {"bpm_names": made["bpm_names"][::-1]}, "'bpm_names' differs from"),
        (lambda made: {"t": 2 * made["t"]}, "'t' says that orbits are"),
        (lambda made: dict.fromkeys(("orbit", "next_orbit"), 0 * made["orbit"]), "stand still"),
        (lambda made: {"model_R": 1.2 * made["model_R"]}, "'model_R' differs from"),
        (lambda made: {}, "'orbit' has the same rows as"),
        (
            lambda made: {name: a[20:] for name, a in made.items() if len(a) == 120},
            "the same rows as",
        ),
    ],
)
def test_a_record_beside_it_has_to_fit(tmp_path, option, spoil, said):
    made = record_files.small()
    asked = record_files.save(tmp_path / "asked.npz", made)
    beside = record_files.save(tmp_path / "beside.npz", made | spoil(made))
    result = run(asked, option, beside)
    assert isinstance(result.exception, RecordError)
    assert said in str(result.exception)
    assert "beside.npz" in str(result.exception)
    assert not (tmp_path / "asked.diagnosis").exists()


def test_json_on_the_terminal_is_the_file_and_nothing_else(engine, record, tmp_path):
    result = run(record, "--json")
    assert json.loads(result.stdout) == json.loads(
        (tmp_path / "shift.diagnosis/diagnosis.json").read_text(encoding="utf-8")
    )


def test_the_fragment_is_what_the_simulator_reads(engine, record, tmp_path):
    run(record)
    file = tmp_path / "shift.diagnosis/effect.toml"
    (effect,) = read_effects(file)
    assert effect.id == "corrector-lag"
    assert effect.names == tuple(f"COR{i:02d}" for i in range(6, 12))
    assert effect.values == {"tau": 0.093}
    assert effect.since == 112.4


def test_a_cause_comes_back_as_the_same_columns_of_the_ring():
    layout = layout_of(Ring.load(), "xy", 0.1)
    columns = [3, 200]
    places = tuple(layout.correctors.label(column) for column in columns)
    cause = examples.lag_cause().model_copy(update={"places": places, "onset_s": None})
    (effect,) = writing.effects_of((cause,))
    assert resolve(effect, layout).tolist() == columns


def test_a_headline_cannot_write_into_the_fragment():
    its = examples.named(headline='x\n[[effect]]\nid = "bpm-gain"\x00')
    assert len(tomllib.loads(writing.fragment(its))["effect"]) == 1


def test_the_fragment_of_an_unknown_ring_says_that_the_default_ring_cannot_use_it():
    strange = parts.Finding(check="unknown-ring", severity="note", text="in no table")
    assert "ring.places" not in writing.fragment(examples.named())
    fragment = writing.fragment(examples.named(findings=(strange,)))
    assert "# No known places table has these names, so the default ring cannot" in fragment
    assert "ring.places" in fragment
    assert len(tomllib.loads(fragment)["effect"]) == 1


def test_a_record_that_is_not_intact_ends_with_3_and_its_findings(engine, record, tmp_path):
    out = tmp_path / "shift.diagnosis"
    run(record)
    engine.findings = (finding("failure"),)
    result = run(record)
    assert result.exit_code == 3
    answer = read_diagnosis(out / "diagnosis.json")
    assert answer.state is None
    assert answer.findings[0].rows == (3, 9)
    assert len(engine.calls) == 1
    assert not (out / "effect.toml").exists()


def test_findings_of_reading_and_screening_are_in_the_answer_once(engine, record, tmp_path):
    engine.findings = engine.noticed = (finding("warning"),)
    assert run(record).exit_code == 0
    answer = read_diagnosis(tmp_path / "shift.diagnosis/diagnosis.json")
    assert [its.check for its in answer.findings] == ["readback-differs", "repeated-samples"]


def test_a_wrong_record_writes_nothing(engine, tmp_path):
    result = run(tmp_path / "none.npz")
    assert isinstance(result.exception, RecordError)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_directory_that_is_a_file_is_refused_before_the_work(engine, record, tmp_path, below):
    (tmp_path / "file").write_text("in the way")
    result = run(record, "--out", tmp_path / "file" / below)
    assert isinstance(result.exception, RecordError)
    assert "--out" in str(result.exception)
    assert not engine.calls
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_plane_that_there_is_not_is_refused(engine, record):
    assert isinstance(run(record, "--planes", "z").exception, ConfigError)


@pytest.mark.parametrize("out", ["", " "])
def test_an_empty_name_is_not_the_current_directory(engine, record, tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    result = run(record, "--out", out)
    assert result.exit_code == 2
    assert "it is empty" in result.output
    assert not engine.calls


def test_a_name_that_is_too_long_is_refused(engine, record, tmp_path):
    result = run(record, "--out", tmp_path / ("x" * 300))
    assert isinstance(result.exception, RecordError)
    assert "too long" in str(result.exception)


@pytest.mark.parametrize("name", ["diagnosis.json", "effect.toml"])
def test_a_directory_in_the_place_of_a_file_is_refused_before_the_work(
    engine, record, tmp_path, name
):
    (tmp_path / "out" / name).mkdir(parents=True)
    result = run(record, "--out", tmp_path / "out")
    assert isinstance(result.exception, RecordError)
    assert f"{tmp_path / 'out' / name} is a directory" in str(result.exception)
    assert not engine.calls
    assert [its.name for its in (tmp_path / "out").iterdir()] == [name]


def test_planes_that_are_not_those_of_the_model_are_the_option_s_fault(engine, record, tmp_path):
    engine.findings = (Finding("swapped-planes", "failure", (), None, "of the other plane"),)
    assert run(record).exit_code == 3
    result = run(record, "--planes", "y")
    assert isinstance(result.exception, ConfigError)
    assert "--planes y" in str(result.exception)


def test_whoever_interrupts_the_writing_keeps_the_old_files(engine, record, tmp_path, monkeypatch):
    run(record)
    out = tmp_path / "shift.diagnosis"
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    engine.answer = examples.unknown()

    def interrupted(diagnosis):
        raise KeyboardInterrupt

    monkeypatch.setattr(writing, "fragment", interrupted)
    result = run(record)
    assert result.exit_code == 130
    assert "interrupted; nothing was written" in result.stderr
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_write_that_fails_leaves_the_old_file_whole(monkeypatch, tmp_path):
    writing.write(examples.unknown(), tmp_path)
    before = (tmp_path / "diagnosis.json").read_text(encoding="utf-8")
    monkeypatch.setattr(writing.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(RecordError, match="full"):
        writing.write(examples.bare(), tmp_path)
    assert (tmp_path / "diagnosis.json").read_text(encoding="utf-8") == before
    assert len(list(tmp_path.iterdir())) == 4
