"""A piece of work that must be done some time: tried until it succeeds, on a thread of its own."""

import threading
from collections.abc import Callable

from orbitfb.core.errors import OrbitFeedbackError

EVERY = 5.0
"""Time between two tries [s]: a disk that has room again is found within it, and a try of a few
kilobytes every five seconds costs nothing."""


class Retry:
    """Does a piece of work when asked; what fails is tried again until it succeeds.

    Args:
        work: What is to be done; being done twice must do no harm.
        failed: Told why the first try failed; not told of the further ones.
        done: Told that all is done after a failure: nothing more was asked for meanwhile.
        every: Time between two tries [s].
        name: Of the thread.
    """

    def __init__(
        self,
        work: Callable[[], None],
        failed: Callable[[OrbitFeedbackError], None] = lambda _: None,
        done: Callable[[], None] = lambda: None,
        every: float = EVERY,
        name: str = "retry",
    ) -> None:
        self._work, self._failed, self._done, self._every = work, failed, done, every
        self._asked, self._stopping = threading.Event(), threading.Event()
        self._failing = self._working = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def pending(self) -> bool:
        """Whether there is work that was asked for and is not done."""
        return self._asked.is_set() or self._working

    def ask(self) -> None:
        """Have the work done; never waits. The first call starts the thread."""
        self._asked.set()
        if self._thread.ident is None:
            self._thread.start()

    def stop(self) -> None:
        """End the thread after one last try of what is pending."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._asked.set()
            self._thread.join()
        if self.pending:
            self.attempt()

    def attempt(self) -> bool:
        """Try once, in this thread; say whether it is done.

        What is asked for while the work runs may have missed it, and is done once more.
        """
        self._working = True  # before the request is taken: it is pending until it is done
        self._asked.clear()
        try:
            self._work()
        except OrbitFeedbackError as error:
            self._asked.set()
            if not self._failing:
                self._failing = True
                self._failed(error)
            return False
        finally:
            self._working = False
        if self._failing and not self._asked.is_set():
            self._failing = False
            self._done()
        return True

    def _run(self) -> None:
        while True:
            self._asked.wait()
            if self._stopping.is_set():
                return
            if not self.attempt():
                self._stopping.wait(self._every)
