"""Work that is tried until it succeeds, without a thread and with one."""

import threading

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.retry import Retry


class Work:
    """Fails as often as it is told to."""

    def __init__(self, failures):
        self.failures, self.done = failures, 0

    def __call__(self):
        if self.failures:
            self.failures -= 1
            raise OrbitFeedbackError("no room")
        self.done += 1


def test_it_is_told_once_that_it_fails_and_once_that_it_is_done():
    told, work = [], Work(3)
    retry = Retry(work, lambda error: told.append(str(error)), lambda: told.append("done"))
    assert [retry.attempt() for _ in range(4)] == [False, False, False, True]
    assert told == ["no room", "done"]
    assert not retry.pending and work.done == 1
    retry.attempt()
    assert told == ["no room", "done"]


def test_what_fails_stays_pending():
    retry = Retry(Work(1))
    retry.attempt()
    assert retry.pending


def test_it_is_not_told_done_while_more_was_asked_for_meanwhile():
    told = []

    def work():
        if not told:
            told.append("failed")
            raise OrbitFeedbackError("no room")
        if told == ["failed"]:
            told.append("asked")
            retry._asked.set()  # as `ask` does from another thread

    retry = Retry(work, done=lambda: told.append("done"))
    retry.attempt()
    retry.attempt()
    assert retry.pending and told == ["failed", "asked"]
    retry.attempt()
    assert not retry.pending and told == ["failed", "asked", "done"]


def test_a_thread_does_it_as_soon_as_it_can():
    done = threading.Event()
    retry = Retry(Work(3), done=done.set, every=0.001)
    retry.ask()
    assert done.wait(10)
    retry.stop()
    assert not retry.pending


def test_the_end_has_a_last_try():
    work = Work(1)
    retry = Retry(work, every=1000.0)
    failed = threading.Event()
    retry._failed = lambda _: failed.set()
    retry.ask()
    assert failed.wait(10)
    retry.stop()
    assert work.done == 1
