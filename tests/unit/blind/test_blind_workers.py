"""Workers of the blind check: what dies, hangs or is asked to end harms nothing else."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.blind import engines, workers
from benchmarks.blind.engines import EngineError, ask, fingerprint, load
from benchmarks.blind.workers import Task, diagnose_all

ENGINE = """
import os, pathlib, subprocess, sys, time

def answer(record, *, without=()):
    with open(record.with_suffix(".asked"), "a") as file:
        file.write("x")
    if record.stem == "raises":
        raise ValueError("bad record")
    if record.stem == "dies":
        os._exit(7)
    if record.stem == "hangs":
        pathlib.Path(record.with_suffix(".pid")).write_text(str(os.getpid()))
        while record.stem == "hangs":
            pass
    if record.stem == "asks":
        busy = "import time\\nwhile time.process_time() < 0.5: pass"
        subprocess.run([sys.executable, "-c", busy], check=True)
    if record.stem == "sleeps":
        time.sleep(60)
    threads = os.environ.get("OPENBLAS_NUM_THREADS")
    return {"state": "no_gap", "name": record.stem, "threads": threads, "without": list(without)}
"""


@pytest.fixture
def engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = f"engine_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(ENGINE)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    monkeypatch.syspath_prepend(str(tmp_path))
    return f"{name}:answer"


def task(folder: Path, engine: str, name: str, state: str = "1", **more) -> Task:
    values = {"later": None, "ring": None, "without": ()} | more
    return Task(engine, folder / name, keep=folder / "kept" / f"{name}.json", state=state, **values)


def test_the_time_of_a_process_that_an_engine_asks_counts(tmp_path: Path, engine: str) -> None:
    (answer,) = diagnose_all([task(tmp_path, engine, "asks")], 1)
    assert answer.cpu > 0.4


def test_what_dies_or_raises_is_told_and_the_rest_is_answered(tmp_path: Path, engine: str) -> None:
    names = ["one", "raises", "dies", "two"]
    tasks = [task(tmp_path, engine, name) for name in names]
    one, raises, dies, two = diagnose_all(tasks, 2)
    for answer, name in ((one, "one"), (two, "two")):
        assert answer.diagnosis is not None
        assert (answer.diagnosis["name"], answer.diagnosis["threads"]) == (name, "1")
        assert 0 <= answer.cpu <= answer.seconds + 0.1
        assert answer.peak_mb > 1
    assert raises.diagnosis is None
    assert "ValueError: bad record" in raises.problem
    assert (dies.diagnosis, dies.problem) == (None, "its process ended: 7")


def test_one_that_takes_too_long_is_ended(tmp_path: Path, engine: str) -> None:
    tasks = [task(tmp_path, engine, name) for name in ("hangs", "after")]
    hangs, after = diagnose_all(tasks, 1, longest=1.0)
    assert (hangs.diagnosis, hangs.problem) == (None, "no answer within 1 s of processor time")
    assert after.diagnosis is not None
    assert not alive(int((tmp_path / "hangs.pid").read_text()))


def test_one_that_waits_for_ever_is_ended_too(tmp_path: Path, engine: str, monkeypatch) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 3.0)
    (sleeps,) = diagnose_all([task(tmp_path, engine, "sleeps")], 1, longest=1.0)
    assert (sleeps.diagnosis, sleeps.problem[:9]) == (None, "no answer")


def test_answers_of_the_same_code_are_kept_and_failures_tried_again(
    tmp_path: Path, engine: str
) -> None:
    def times(name: str) -> int:
        return len((tmp_path / f"{name}.asked").read_text())

    for _ in range(2):
        diagnose_all([task(tmp_path, engine, "one"), task(tmp_path, engine, "raises")], 1)
    assert (times("one"), times("raises")) == (1, 2)
    diagnose_all([task(tmp_path, engine, "one", state="2")], 1)
    assert times("one") == 2


def test_an_engine_is_told_what_it_has_a_keyword_for(tmp_path: Path) -> None:
    def plain(record: Path):
        return {"record": record}

    def more(record: Path, **told):
        return told

    assert ask(plain, tmp_path, later=tmp_path, without=()) == {"record": tmp_path}
    assert ask(more, tmp_path, later=1, without=("x",)) == {"later": 1, "without": ("x",)}
    with pytest.raises(EngineError, match="cannot leave an effect out"):
        ask(plain, tmp_path, without=("bpm-gain",))


@pytest.mark.parametrize("name", ["nowhere:f", "json:nothing", "json", "json:__name__"])
def test_an_engine_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(EngineError, match=f"--engine {name}"):
        load(name)


def test_other_code_has_another_fingerprint(tmp_path: Path, engine: str) -> None:
    before = fingerprint(engine)
    assert before == fingerprint(engine)
    file = tmp_path / f"{engine.partition(':')[0]}.py"
    file.write_text(file.read_text() + "\n# changed\n")
    assert fingerprint(engine) != before
    assert fingerprint(engines.INSTALLED) != before


CHECK = """
import sys
from pathlib import Path
from benchmarks.blind.workers import Task, diagnose_all

folder, engine = Path(sys.argv[1]), sys.argv[2]
if __name__ == "__main__":
    names = ("hangs", "next")
    diagnose_all([Task(engine, folder / n, None, None, (), folder / n, "1") for n in names], 1)
"""


def alive(process: int) -> bool:
    """Whether a process runs; one that has ended and was not asked for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until(true, seconds: float = 30.0) -> bool:
    """Wait for something."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if true():
            return True
        time.sleep(0.05)
    return False


def test_what_a_check_started_ends_with_it(tmp_path: Path, engine: str) -> None:
    (tmp_path / "check.py").write_text(CHECK)
    root = Path(workers.__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(root)])}
    told = [sys.executable, str(tmp_path / "check.py"), str(tmp_path), engine]
    check = subprocess.Popen(told, env=environment, cwd=root)
    pid = tmp_path / "hangs.pid"
    try:
        assert until(lambda: pid.exists() and pid.read_text() != "")
        worker = int(pid.read_text())
        check.send_signal(signal.SIGTERM)
        assert check.wait(20.0) == 128 + signal.SIGTERM
        assert until(lambda: not alive(worker))
        assert not (tmp_path / "next.asked").exists()
    finally:
        check.kill()
        check.wait()
