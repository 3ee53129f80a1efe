"""Minutes of real time over Channel Access: `orbitfb run` and `orbitfb ioc` as they ship."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError
from orbitfb.history.archive import read_archive
from tests.soak.flat import Soak, first_and_last

CONFIG = """
[loop]
rate_hz = {rate}
[web]
port = 0
[history]
capacity = {capacity}
"""
FILLED = 0.1
"""Part of the time in which the history in memory is full, at most 2000 ticks."""
SETTLED = 0.2
"""Part of the time that is not looked at: buffers fill, modules are loaded, the learner starts."""
START = 20.0
"""After it no orbit is missed: the learner and the live diagnosis have started [s]."""
SAMPLE = 5.0
"""Between two samples of the process [s]."""


@contextlib.contextmanager
def _process(words: list[str], directory: Path, name: str) -> Iterator["subprocess.Popen[str]"]:
    with (directory / f"{name}.out").open("w") as out, (directory / f"{name}.err").open("w") as err:
        popen = subprocess.Popen(
            [sys.executable, "-m", "orbitfb", *words],
            stdout=out,
            stderr=err,
            text=True,
            start_new_session=True,
        )
    try:
        yield popen
        popen.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            popen.wait(15)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(popen.pid, signal.SIGKILL)
        popen.wait(10)


def over_ca(
    minutes: float,
    directory: Path,
    rate: float = 10.0,
    say: Callable[[str], None] = lambda _: None,
) -> Soak:
    """Run so long in real time.

    Args:
        minutes: Time after the loop has closed [min].
        directory: For everything.
        rate: Of loop and ring [Hz].
        say: Gets a line now and then.

    Raises:
        RuntimeError: The service or the ring does not start, or the loop is not CLOSED at the end.
    """
    capacity = round(min(2000, max(300, FILLED * minutes * 60 * rate)))
    (directory / "c.toml").write_text(CONFIG.format(rate=rate, capacity=capacity))
    data = directory / "data"
    began = time.monotonic()
    ring_words = ["ioc", "--port", "0", "--rate", str(rate)]
    with _process(ring_words, directory, "ioc") as ring:
        text = _until(lambda: (directory / "ioc.out").read_text(), "EPICS_CA_SERVER_PORT=", ring)
        port = text.split("EPICS_CA_SERVER_PORT=")[1].split()[0]
        words = ["run", "--ioc", f"127.0.0.1:{port}", "--config", str(directory / "c.toml")]
        words += ["--data", str(data), "--metrics-port", "0", "--start", "closed"]
        with _process(words, directory, "run") as service:
            _until(lambda: str(_status(data).get("state")), "CLOSED", service)
            rows, missed, end = [], [], time.monotonic() + minutes * 60
            while time.monotonic() < end:
                rows.append(_sample(service.pid))
                status = _status(data)
                missed.append(int(status.get("missed_ticks", missed[-1] if missed else 0)))
                if len(rows) % 60 == 0:
                    say(
                        f"{len(rows) * SAMPLE / 60:.0f} min: {rows[-1][0]:.1f} MB, "
                        f"{status.get('state')}, {missed[-1]} missed"
                    )
                time.sleep(min(SAMPLE, max(0.0, end - time.monotonic())))
            if (state := _status(data).get("state")) != "CLOSED":
                raise RuntimeError(f"the loop is {state} after {minutes} min")
    archive = read_archive(data / "archive")
    latency = (archive.written - archive.time) * 1e3
    latency = latency[np.isfinite(latency)]
    latency = latency[round(START * rate) :]
    kept = np.array(rows)[int(SETTLED * len(rows)) :]
    part, window = max(1, len(kept) // 4), min(round(600 * rate), len(latency) // 3)
    memory, files, threads, children = (first_and_last(c, part, np.median) for c in kept.T)
    return Soak(
        "over Channel Access",
        len(latency),
        minutes / 60,
        round(time.monotonic() - began, 1),
        memory,
        files,
        threads,
        first_and_last(latency, window, lambda part: np.percentile(part, 99)),
        first_and_last(latency, window, np.median),
        missed[-1] - missed[min(len(missed) - 1, round(START / SAMPLE))],
        f"its other processes: {children[0]:.0f} -> {children[1]:.0f} MB",
    )


def _until(look: Callable[[], str], word: str, process: "subprocess.Popen[str]") -> str:
    deadline = time.monotonic() + 60.0
    while word not in (text := look()):
        if process.poll() is not None or time.monotonic() > deadline:
            raise RuntimeError(f"no {word} within 60 s, but {text!r}")
        time.sleep(0.1)
    return text


def _status(data: Path) -> dict[str, Any]:
    try:
        return ask(data, {"command": "status"})
    except (ControlError, json.JSONDecodeError):
        return {}


def _sample(pid: int) -> tuple[float, int, int, float]:
    process = psutil.Process(pid)
    others = 0
    for child in process.children(recursive=True):
        with contextlib.suppress(psutil.Error):
            others += child.memory_info().rss
    memory = process.memory_info().rss
    return memory / 2**20, process.num_fds(), process.num_threads(), others / 2**20
