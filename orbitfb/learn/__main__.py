"""The process of the trainer, `python -m orbitfb.learn DESCRIPTOR`: `ProcessTrainer` starts it."""

import contextlib
import os
import sys
import threading
from dataclasses import replace
from multiprocessing.connection import Connection

from orbitfb.core.ports import Policy
from orbitfb.learn.learner import Learner
from orbitfb.learn.messages import AnswerMessage, TaskMessage, TrainerJob, learner_of, pack, unpack
from orbitfb.learn.trainer import Task, work

_NICE = 10


def main(descriptor: int) -> None:
    """Answer tasks until the parent lets go.

    Args:
        descriptor: The child's end of the pair of sockets.
    """
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    os.nice(_NICE)
    with Connection(descriptor) as connection, contextlib.suppress(EOFError, ConnectionError):
        connection.send("hello")  # what is sent before it would wait for the imports above
        job: TrainerJob = connection.recv()
        learner = learner_of(job)
        incumbent: Policy | None = None
        while True:
            message: TaskMessage = connection.recv()
            incumbent = _incumbent(message, incumbent)
            connection.send(answer(learner, message, incumbent))


def answer(learner: Learner, message: TaskMessage, incumbent: Policy) -> AnswerMessage:
    """Do a task that came."""
    task = Task(message.transitions, incumbent, message.trigger, message.may_refit, message.afresh)
    done = work(learner, task)
    candidate = None if done.candidate is None else pack(done.candidate)
    return AnswerMessage(replace(done, candidate=None), candidate, learner.last_tick)


def _incumbent(message: TaskMessage, before: Policy | None) -> Policy:
    if message.policy is not None:
        return unpack(message.policy)
    if before is None or before.policy_id != message.incumbent:
        raise SystemExit(f"the policy {message.incumbent} was never sent")
    return before


def _end_with_parent() -> None:
    """End at once when the parent is gone, also in the middle of a training."""
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(0)


if __name__ == "__main__":
    main(int(sys.argv[1]))
