"""Nothing executes what a file holds; every reader of files is known, bounded and in the docs."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from source_rules import opens, unbounded_reads, violations

ROOT = Path(__file__).parents[3]
SOURCES = sorted((ROOT / "orbitfb").rglob("*.py"))

WHOLE = {
    "core/files/delimited.py": "one line of a text that was read with a bound",
    "cli/evaluation/paper.py": "the table that it has just written",
    "epics/lease/late.py": "a PV, no file: texts of 40 characters",
    "epics/lease/lease.py": "a PV, no file: texts of 40 characters",
    "evaluate/paper/report/page.py": "the picture that it has just drawn",
    "evaluate/pool/task.py": "source files of the package itself",
    "exchange/formats/archiver.py": "size checked before (check_file)",
    "exchange/formats/csv_file.py": "size checked before (check_file)",
    "exchange/formats/source.py": "size checked before (check_file)",
    "learn/process.py": "standard error of its own child",
    "page/app.py": "files of the package itself",
    "physics/places.py": "files of the package itself",
    "physics/table.py": "a text that was read with a bound",
    "sim/child.py": "standard error of its own child",
}
"""Modules that may read to the end, and why."""

READERS = {
    "records/reading/hdf5.py",
    "records/reading/npz.py",
    "evaluate/pool/task.py",
    "exchange/orbits/parquet.py",
    "exchange/formats/hdf5_file.py",
    "exchange/orbits/history.py",
    "exchange/formats/mat5_file.py",
    "exchange/response/export.py",
    "history/segment.py",
    "history/verify.py",
    "loco/input/parts.py",
    "loop/excitation/file.py",
    "postmortem/encoding.py",
    "postmortem/opening.py",
}
"""Modules that hand files to h5py, zipfile, numpy or scipy; reviewed, see docs/…/threats.md."""

Rule = Callable[[str], Iterator[tuple[int, str]]]


def found(rule: Rule) -> dict[str, list[str]]:
    result: dict[str, list[str]] = {}
    for path in SOURCES:
        for line, words in rule(path.read_text(encoding="utf-8")):
            result.setdefault(str(path.relative_to(ROOT / "orbitfb")), []).append(
                f"line {line}: {words}"
            )
    return result


def test_nothing_executes_what_a_file_holds():
    assert len(SOURCES) > 300
    assert found(violations) == {}


def test_nothing_reads_to_the_end_of_somebody_elses_file():
    others = {name: where for name, where in found(unbounded_reads).items() if name not in WHOLE}
    assert others == {}, "use orbitfb.core.files.bounded, or say in WHOLE why the end is near"


def test_readers_of_containers_are_known():
    others = {name: where for name, where in found(opens).items() if name not in READERS}
    assert others == {}, "bound sizes before reading, add a row to threats.md, and the module here"


def test_readers_are_in_the_page_of_threats():
    page = (ROOT / "docs/explanations/threats.md").read_text()
    assert [name for name in sorted(READERS) if f"`{name}`" not in page] == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from cloudpickle import loads",
        "import marshal as m",
        "eval(text)",
        "exec(open(path).read())",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "numpy.load(path, allow_pickle=wanted)",
        "torch.load(path)",
        "yaml.load(stream)",
        "os.system(command)",
        "subprocess.run(command, shell=True)",
        "something.load(path, weights_only=False)",
    ],
)
def test_the_rules_find_what_they_are_for(source: str):
    assert list(violations(source))


@pytest.mark.parametrize(
    "source",
    [
        "path.read_text()",
        "Path(name).read_bytes()",
        "tomllib.load(file)",
        "json.load(file)",
        "file.read()",
    ],
)
def test_the_rules_find_reads_without_end(source: str):
    assert list(unbounded_reads(source))


@pytest.mark.parametrize(
    "source",
    [
        "np.load(path, allow_pickle=False)",
        "subprocess.run([program, path], shell=False)",
        "re.compile(words)",
        "yaml.safe_load(text)",
        "file.read(LARGEST + 1)",
        "read_text(path, LARGEST, ConfigError, advice)",
    ],
)
def test_the_rules_leave_the_rest_alone(source: str):
    assert not [*violations(source), *unbounded_reads(source)]
