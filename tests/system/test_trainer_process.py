"""The trainer in a process of its own: the same answers, its death, its end with the parent."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from orbitfb.core.ports import Policy
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.learn.builders import first_policy
from orbitfb.learn.learner import Learner
from orbitfb.learn.messages import TrainerJob, learner_of, pack, unpack
from orbitfb.learn.process import ProcessTrainer
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.trainer import Answer, Task, work
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.policies.settings import PolicySettings

pytestmark = pytest.mark.system

PLANT = Plant(Ring.load(), seed=1)
WRONG = 0.7 * PLANT.response
WIDE = LearnSettings.model_validate({"identify": {"prior_relative": 1.0}})


def wait(look, timeout=60.0):
    deadline = time.monotonic() + timeout
    while not (seen := look()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return seen


def ask(trainer: ProcessTrainer, task: Task) -> Answer:
    wait(lambda: trainer.ready)
    trainer.submit(task)
    assert not trainer.ready
    return wait(trainer.collect)


def loop(policy: Policy, ticks: int = 200) -> ClosedLoop:
    return ClosedLoop(Plant(Ring.load(), seed=1), policy, ticks).run()


@pytest.fixture
def begin():
    trainers = []

    def start(kind="svd", settings=WIDE, first=None, **job):
        asked = TrainerJob(settings, PolicySettings(kind=kind), WRONG, **job)
        trainers.append(ProcessTrainer(asked))
        policy = first_policy(WRONG, PolicySettings(kind=first or kind), job.get("movable"))
        return trainers[-1], learner_of(asked), policy

    yield start
    for trainer in trainers:
        trainer.close()


@pytest.mark.parametrize(
    "kind",
    ["svd", *(pytest.param(kind, marks=pytest.mark.nightly) for kind in ("network", "modal"))],
)
def test_it_answers_as_the_learner_here_does(begin, kind):
    trainer, learner, incumbent = begin(kind)
    assert isinstance(learner, Learner)
    first, second = loop(incumbent).transitions(), None
    for trigger in (None, "periodic"):
        rows = first if second is None else second
        ours = ask(trainer, Task(rows, incumbent, trigger, may_refit=False))
        theirs = work(learner, Task(rows, incumbent, trigger, may_refit=False))
        assert trainer.last_tick == learner.last_tick
        second = loop(incumbent, 260).transitions(199)
    assert ours.report is not None and theirs.report is not None
    assert ours.report.figures == pytest.approx(dict(theirs.report.figures), rel=1e-3)
    assert ours.report.decision == theirs.report.decision
    assert ours.candidate is not None and theirs.candidate is not None
    error = 1e-6 * np.random.default_rng(1).standard_normal(180)
    valid = np.ones(180, dtype=bool)
    np.testing.assert_allclose(
        ours.candidate.act(error, valid, ours.candidate.initial_state())[0],
        theirs.candidate.act(error, valid, theirs.candidate.initial_state())[0],
        rtol=1e-3,
        atol=1e-7,
    )


@pytest.mark.nightly
def test_masked_correctors_stay_masked_on_the_way(begin):
    movable = np.ones(180, dtype=bool)
    movable[[3, 77]] = False
    trainer, _, incumbent = begin(movable=movable)
    answer = ask(trainer, Task(loop(incumbent).transitions(), incumbent, "on-demand"))
    assert answer.candidate is not None
    error, valid = 1e-5 * np.ones(180), np.ones(180, dtype=bool)
    change, _ = answer.candidate.act(error, valid, answer.candidate.initial_state())
    assert (change[~movable] == 0).all() and (change[movable] != 0).all()
    assert unpack(pack(incumbent)).policy_id == incumbent.policy_id


def test_what_goes_wrong_there_is_told_here(begin):
    trainer, _, incumbent = begin()
    answer = ask(trainer, Task(loop(incumbent, 2).transitions(5), incumbent, "on-demand"))
    assert answer.failure.startswith("none of the transitions can be used")
    assert answer.trigger == "on-demand"


def test_a_killed_trainer_is_noticed_and_a_new_one_begins(begin, monkeypatch):
    monkeypatch.setattr("orbitfb.learn.process._RESTART_AFTER", 0.2)
    trainer, _, incumbent = begin()
    rows = loop(incumbent).transitions()
    ask(trainer, Task(rows, incumbent, may_refit=False))
    first = trainer.pid
    os.kill(first, signal.SIGKILL)
    # Its death is noticed by who asks whether it is ready: until then it still seems to be.
    answer = wait(lambda: None if trainer.ready else trainer.collect())
    assert f"process {first} ended (killed by signal 9)" in answer.failure
    assert trainer.last_tick is None  # so that the rows in memory come again
    report = ask(trainer, Task(rows, incumbent, "periodic")).report
    # All but the last row, which waits for the orbit after it.
    assert report is not None and report.rows == 198
    assert trainer.pid != first


def test_killed_in_the_middle_of_a_task_it_is_answered(begin):
    trainer, _, incumbent = begin("supervised", first="network")
    rows = loop(incumbent).transitions()
    wait(lambda: trainer.ready)
    trainer.submit(Task(rows, incumbent, "on-demand"))
    time.sleep(0.3)
    os.kill(trainer.pid, signal.SIGKILL)
    answer = wait(trainer.collect)
    assert answer.trigger == "on-demand" and "ended" in answer.failure


def test_close_leaves_nothing(begin):
    trainer, _, _ = begin()
    wait(lambda: trainer.ready)
    child = psutil.Process(trainer.pid)
    assert child.nice() >= 10
    trainer.close()
    assert not child.is_running()


def test_it_does_not_outlive_a_killed_parent(tmp_path: Path):
    """Also while it computes: a parent that is killed does not wait for a training."""
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys, time\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import test_trainer_process as t\n"
        "from orbitfb.learn.process import ProcessTrainer\n"
        "policy = t.PolicySettings(kind='supervised')\n"
        "trainer = ProcessTrainer(t.TrainerJob(t.WIDE, policy, t.WRONG))\n"
        "incumbent = t.first_policy(t.WRONG, t.PolicySettings(kind='network'))\n"
        "rows = t.loop(incumbent, 120).transitions()\n"
        "t.wait(lambda: trainer.ready)\n"
        "trainer.submit(t.Task(rows, incumbent, 'on-demand'))\n"
        "print(trainer.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        time.sleep(0.3)
        assert psutil.pid_exists(pid)
        parent.kill()
    wait(lambda: not psutil.pid_exists(pid), timeout=10.0)
