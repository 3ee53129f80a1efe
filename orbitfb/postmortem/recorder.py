"""Freezes the last seconds at every trip, in a thread of its own; the tick never waits for it."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbitfb.core.errors import ControlError
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Channels, Mask, TickRecord
from orbitfb.core.status import PostMortemStatus
from orbitfb.postmortem.encoding import encode
from orbitfb.postmortem.frozen import Frozen
from orbitfb.postmortem.settings import PostMortemSettings
from orbitfb.postmortem.shelf import Shelf
from orbitfb.postmortem.tape import Tape

MOST_WAITING = 8
"""Post-mortems that may wait for the disk; more are given up and counted."""

_CLOSE_WAIT = 1.5
_BREATH = 0.5e-3


@dataclass(frozen=True, slots=True)
class Listeners:
    """Who is told what became of a post-mortem; called in the recorder's thread.

    Args:
        written: Gets the file and what it is about.
        failed: Gets why one is lost.
        removed: Gets old files that were taken away.
    """

    written: Callable[[Path, Frozen], None]
    failed: Callable[[str], None]
    removed: Callable[[list[Path]], None]


@dataclass(frozen=True, slots=True)
class Run:
    """What every file says of the run.

    Args:
        channels: The names behind the vectors.
        counting: BPMs that are not masked by configuration, shape (n,).
        configuration: The whole configuration, as TOML.
        about: What else there is to say, made of what JSON knows.
    """

    channels: Channels
    counting: Mask
    configuration: str
    about: Mapping[str, Any]


class PostMortemRecorder:
    """Keeps the last ticks and events, and writes them when the loop trips.

    A subscriber of the loop: it keeps a reference to every record, which costs a few
    microseconds, and a lock that is never held for longer. Arrays, file and disk are the
    thread's business. When the disk refuses, that post-mortem is lost, counted and told.

    Args:
        directory: Where the files lie.
        settings: How much is kept.
        run: What every file says of the run.
        listeners: Who is told.
        clock: The loop's.
    """

    def __init__(
        self,
        directory: Path,
        settings: PostMortemSettings,
        run: Run,
        listeners: Listeners,
        clock: Clock,
    ) -> None:
        self._settings, self._run_facts, self._listeners = settings, run, listeners
        self._shelf = Shelf(directory)
        self._tape = Tape(settings, clock)
        self._lock = threading.Lock()
        self._queue: deque[tuple[Frozen, Future[Path] | None]] = deque()
        self._writing = False
        self._written = self._failed = 0
        self._last = self._problem = ""
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="postmortem", daemon=True)
        self._thread.start()

    def __call__(self, record: TickRecord) -> None:
        """Take a record; never waits."""
        with self._lock:
            made = self._tape.tick(record)
            pending = self._tape.next_due() is not None
        for frozen in made:
            self._hand_over(frozen, None)
        if made or (pending and not self._wake.is_set()):
            self._wake.set()

    def tell(self, level: str, name: str, fields: dict[str, Any]) -> None:
        """Take an event, from any thread."""
        with self._lock:
            self._tape.tell(level, name, fields)

    def request(self, who: str) -> "Future[Path]":
        """Freeze the last seconds now.

        Args:
            who: Who asks for it.

        Returns:
            The file, or a `ControlError` with why there is none.
        """
        future: Future[Path] = Future()
        with self._lock:
            frozen = self._tape.now(who)
        self._hand_over(frozen, future)
        self._wake.set()
        return future

    def status(self) -> PostMortemStatus:
        """Say what became of the post-mortems."""
        waiting = len(self._queue) + self._writing
        return PostMortemStatus(self._written, self._failed, waiting, self._last, self._problem)

    def close(self) -> None:
        """Write what waits and stop; a disk that hangs is not waited for long."""
        self._stop.set()
        self._wake.set()
        self._thread.join(_CLOSE_WAIT)

    def _hand_over(self, frozen: Frozen, asked: "Future[Path] | None") -> None:
        if self._stop.is_set():
            self._give_up("the service is stopping; no more post-mortems are written", asked)
        elif len(self._queue) >= MOST_WAITING:
            self._give_up(
                f"{MOST_WAITING} post-mortems wait for the disk; this one is given up", asked
            )
        else:
            self._queue.append((frozen, asked))

    def _run(self) -> None:
        self._sweep()
        while not self._stop.is_set():
            with self._lock:
                left = self._tape.next_due()
            self._wake.wait(left)
            self._wake.clear()
            self._take_overdue()
            self._drain()
        with self._lock:
            left_over = self._tape.finish()
        self._queue.extend((frozen, None) for frozen in left_over)
        self._drain()

    def _take_overdue(self) -> None:
        with self._lock:
            made = self._tape.overdue()
        for frozen in made:
            self._hand_over(frozen, None)

    def _drain(self) -> None:
        while self._queue:
            self._writing = True
            frozen, asked = self._queue.popleft()
            try:
                path = self._write(frozen)
            except Exception as error:  # the guard of this thread: told and counted
                self._give_up(
                    f"the post-mortem of tick {frozen.cause.tick} cannot be written to "
                    f"{self._shelf.directory} ({error}); make room or repair the directory: it is "
                    "lost, the archive has the ticks if that was written",
                    asked,
                )
            else:
                self._written += 1
                self._last, self._problem = path.name, ""
                self._listeners.written(path, frozen)
                if asked is not None:
                    asked.set_result(path)
                self._trim()
            self._writing = False

    def _write(self, frozen: Frozen) -> Path:
        run = self._run_facts
        content = encode(
            frozen, run.channels, run.counting, run.configuration, run.about, self._breathe
        )
        return self._shelf.put(frozen.cause.wall, content)

    def _breathe(self) -> None:
        if not self._stop.is_set():
            time.sleep(_BREATH)

    def _sweep(self) -> None:
        try:
            self._shelf.sweep()
        except OSError as error:
            self._listeners.failed(f"{self._shelf.directory} cannot be swept ({error})")

    def _trim(self) -> None:
        try:
            removed = self._shelf.trim(
                self._settings.kept_files, 1e6 * self._settings.kept_megabytes
            )
        except OSError as error:
            self._listeners.failed(
                f"old post-mortems in {self._shelf.directory} cannot be removed ({error})"
            )
        else:
            if removed:
                self._listeners.removed(removed)

    def _give_up(self, problem: str, asked: "Future[Path] | None") -> None:
        self._failed += 1
        self._problem = problem
        self._listeners.failed(problem)
        if asked is not None:
            asked.set_exception(ControlError(problem))
