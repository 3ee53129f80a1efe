"""What a test leaves behind: child processes, threads, ports on which it listens."""

import contextlib
import os
import socket
import stat
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

_INTERNET = (socket.AF_INET, socket.AF_INET6)
PATIENCE = 2.0
"""How long what a test has stopped may take to be gone [s]."""


def _descendants() -> list[psutil.Process]:
    """Children, and theirs. Linux keeps a list with every thread; psutil reads of all processes.

    The fork server is a child from its start to the end of all tests, and they are asked twice at
    every test.
    """
    asked, found = [os.getpid()], []
    try:
        for parent in asked:
            for thread in os.listdir(f"/proc/{parent}/task"):
                told = Path(f"/proc/{parent}/task/{thread}/children").read_text()
                asked += map(int, told.split())
    except OSError:  # one has ended meanwhile, or there are no such lists
        return psutil.Process().children(recursive=True)
    for pid in asked[1:]:
        with contextlib.suppress(psutil.NoSuchProcess):
            found.append(psutil.Process(pid))
    return found


def _children() -> set[str]:
    found: set[str] = set()
    for child in _descendants():
        try:
            command = " ".join(child.cmdline())
            if child.status() != psutil.STATUS_ZOMBIE and "resource_tracker" not in command:
                found.add(f"process {child.pid}: {command or child.name()}")
        except psutil.NoSuchProcess:
            continue
    return found


def _threads() -> set[str]:
    """Threads that Python started; those of libca live as long as the process."""
    return {
        f"thread {thread.ident}: {thread.name}"
        for thread in threading.enumerate()
        if not isinstance(thread, threading._DummyThread)
    }


def listeners() -> set[str]:
    """TCP ports on which this process listens.

    Its own descriptors are asked: the system's table of connections takes ten milliseconds to read,
    twice at every test.
    """
    found: set[str] = set()
    for descriptor in map(int, os.listdir("/proc/self/fd")):
        try:
            if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                continue
            with socket.socket(fileno=os.dup(descriptor)) as copy:
                is_tcp = copy.family in _INTERNET and copy.type == socket.SOCK_STREAM
                if is_tcp and copy.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                    found.add(f"listening port {copy.getsockname()[1]}")
        except OSError:  # it is closed by now
            continue
    return found


def watch() -> Iterator[None]:
    """Fail at the end if something is left that was not there at the beginning."""

    def present() -> set[str]:
        return _children() | _threads() | listeners()

    before = present()
    yield
    deadline = time.monotonic() + PATIENCE
    while left := present() - before:
        if time.monotonic() > deadline:
            pytest.fail("left behind: " + "; ".join(sorted(left)))
        time.sleep(0.02)
