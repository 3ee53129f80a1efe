"""The control socket and the locks: one holder, one answer for every message, good or bad."""

import contextlib
import errno
import os
import pwd
import re
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from orbitfb.control import server as control
from orbitfb.control.client import MESSAGE_LIMIT, ask, is_running, socket_path
from orbitfb.control.server import MOST_CONVERSATIONS, ControlServer
from orbitfb.core.errors import ControlError, OwnershipError
from orbitfb.core.files import ownership
from orbitfb.core.files.ownership import Lock, runtime_directory


@pytest.fixture(autouse=True)
def own_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def handle(request: Mapping[str, Any]) -> Mapping[str, Any]:
    match request.get("command"):
        case "refused":
            raise ControlError("reset refused in OPEN: there is nothing to reset")
        case "broken":
            raise KeyError("a mistake of ours")
        case "not json":
            return {"figure": float("nan")}
    return {"echo": request}


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Path]:
    data = tmp_path / "data"
    server = ControlServer(data, handle)
    yield data
    server.close()


def test_an_answer_comes_back(served: Path):
    asked = {"command": "x", "µ": [1.5], "peer": {"user": "somebody else"}}
    echo = ask(served, asked)["echo"]
    # who asks is known from the kernel, whatever the request says
    peer = {"user": pwd.getpwuid(os.getuid()).pw_name, "process": os.getpid()}
    assert echo == {"command": "x", "µ": [1.5], "peer": peer}
    assert is_running(served)


def test_a_refusal_is_told_as_it_is(served: Path):
    with pytest.raises(ControlError, match=r"^reset refused in OPEN: there is nothing to reset$"):
        ask(served, {"command": "refused"})


@pytest.mark.parametrize("command", ["broken", "not json"])
def test_a_mistake_of_the_service_is_told_and_it_goes_on(served: Path, command: str):
    with pytest.raises(ControlError, match=r"the service failed at this: \w+Error"):
        ask(served, {"command": command})
    assert ask(served, {"command": "x"})


def raw(data: Path, message: bytes) -> bytes:
    """Send bytes and give all that comes back."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(5.0)
        connection.connect(str(socket_path(data)))
        connection.sendall(message)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(65536), b""))


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        (b"{]\n", b"the message is not JSON"),
        (b"\xff\xfe\n", b"the message is not JSON"),
        (b"[" * 100_000 + b"\n", b"the message is not JSON"),
        (b"[1, 2]\n", b"the message is not a JSON object"),
        (b"{}", b"connection closed in the middle of a message"),
        (b"", b"connection closed in the middle of a message"),
    ],
)
def test_a_bad_message_gets_an_answer(served: Path, message: bytes, answer: bytes):
    assert answer in raw(served, message)
    assert ask(served, {"command": "x"})


def test_a_message_without_end_is_refused(served: Path):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(5.0)
        connection.connect(str(socket_path(served)))
        with pytest.raises(OSError, match=r"Broken pipe|reset"):
            for _ in range(MESSAGE_LIMIT):
                connection.sendall(b" " * 65536)
    assert ask(served, {"command": "x"})


def test_a_client_that_says_nothing_keeps_nobody(served: Path):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(str(socket_path(served)))
        assert ask(served, {"command": "x"})


def test_many_ask_at_once(served: Path):
    answers: list[dict[str, Any]] = []

    def ask_one(number: int) -> None:
        answers.append(ask(served, {"command": number}))

    threads = [threading.Thread(target=ask_one, args=(number,)) for number in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(5.0)
    assert sorted(a["echo"]["command"] for a in answers) == list(range(20))


def test_only_its_user_can_open_the_socket(served: Path):
    path = socket_path(served)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_nobody_there(tmp_path: Path):
    assert not is_running(tmp_path)
    with pytest.raises(ControlError) as caught:
        ask(tmp_path, {"command": "status"})
    text = str(caught.value)
    assert text.startswith(f"no service of this user runs on {tmp_path}; start one with")
    assert f"{tmp_path}/orbitfb-{os.getuid()}" in text  # where it looked


def test_a_socket_left_by_a_killed_service_is_taken_over(tmp_path: Path):
    path = socket_path(tmp_path)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    assert path.exists() and not is_running(tmp_path)
    server = ControlServer(tmp_path, handle)
    assert ask(tmp_path, {"command": "x"})
    server.close()
    assert not path.exists()


def test_a_service_that_does_not_answer(tmp_path: Path):
    with socket.socket(socket.AF_UNIX) as mute:
        mute.bind(str(socket_path(tmp_path)))
        mute.listen()
        with pytest.raises(ControlError, match=r"the service did not answer within 0.05 s"):
            ask(tmp_path, {"command": "x"}, timeout=0.05)


def test_a_path_too_long_for_a_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / ("x" * 120)))
    server = ControlServer(tmp_path, handle)
    assert is_running(tmp_path) and ask(tmp_path, {"command": "x"})
    server.close()
    assert not is_running(tmp_path)


def test_relative_and_absolute_names_are_one(
    served: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    assert ask(Path("data"), {"command": "x"})


def test_without_a_run_time_directory_it_is_the_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr(ownership.tempfile, "tempdir", str(tmp_path / "t"))
    assert runtime_directory() == tmp_path / "t" / f"orbitfb-{os.getuid()}"


def test_a_run_time_directory_that_is_open_to_others_is_refused():
    path = runtime_directory()
    path.chmod(0o755)
    with pytest.raises(OwnershipError, match=rf"{path} must be a directory of user .* remove it"):
        runtime_directory()


@pytest.mark.parametrize("kind", ["link", "file"])
def test_a_run_time_directory_that_is_none_is_refused(tmp_path: Path, kind: str):
    path = tmp_path / f"orbitfb-{os.getuid()}"
    if kind == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        path.symlink_to(tmp_path / "elsewhere")
    else:
        path.write_text("")
    with pytest.raises(OwnershipError, match=re.escape(str(path))):
        runtime_directory()


def test_a_run_time_directory_that_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    for attempt in (lambda: ask(tmp_path, {}), lambda: Lock("a", "it", "stop")):
        with pytest.raises(OwnershipError) as caught:
            attempt()
        assert str(caught.value) == (
            f"{tmp_path}/file/orbitfb-{os.getuid()}, for locks and the control socket, cannot be "
            "made (Not a directory); set XDG_RUNTIME_DIR to a directory of your own, or unset it"
        )


def test_a_lock_has_one_holder():
    with Lock("ring 1", "the ring", "stop it first"):
        with pytest.raises(OwnershipError) as caught:
            Lock("ring 1", "the ring", "stop it first")
        assert str(caught.value) == (
            f"the ring is held by another orbitfb (process {os.getpid()}); stop it first"
        )
        with Lock("ring 2", "another ring", ""):
            pass
    with Lock("ring 1", "the ring", ""):
        pass


def test_a_lock_is_free_when_its_holder_is_killed():
    code = (
        "from orbitfb.core.files.ownership import Lock; "
        "lock = Lock('r', '', ''); print(1, flush=True)"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", f"{code}; input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(OwnershipError, match=rf"\(process {holder.pid}\)"):
            Lock("r", "the ring", "")
        holder.kill()
        holder.wait()
        with Lock("r", "the ring", ""):
            pass


def connect_to(data: Path) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(5.0)
    connection.connect(str(socket_path(data)))
    return connection


def test_those_who_only_connect_give_way_to_those_who_ask(served: Path):
    idle = [connect_to(served) for _ in range(2 * MOST_CONVERSATIONS)]
    assert ask(served, {"command": "x"})
    left = 0
    for connection in idle:
        connection.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            left += connection.recv(1) == b""
        connection.close()
    assert left >= MOST_CONVERSATIONS


def test_while_all_are_being_answered_one_more_is_told_to_wait(tmp_path: Path):
    go, heard = threading.Event(), threading.Semaphore(0)

    def slow(_: Mapping[str, Any]) -> Mapping[str, Any]:
        heard.release()
        go.wait(60.0)
        return {}

    server = ControlServer(tmp_path, slow)
    asked = [connect_to(tmp_path) for _ in range(MOST_CONVERSATIONS)]
    for connection in asked:
        connection.sendall(b"{}\n")
    for _ in asked:  # one that was not heard yet is idle, and would give way to the next
        assert heard.acquire(timeout=30.0)
    with connect_to(tmp_path) as more:
        more.settimeout(30.0)
        answer = more.recv(1000)
    go.set()
    for connection in asked:
        assert connection.recv(100) == b'{"ok": true}\n'
        connection.close()
    server.close()
    assert b"ask again in some seconds" in answer


def test_without_descriptors_it_waits_and_answers_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    short = threading.Event()
    accept = socket.socket.accept

    def none_left(listener: socket.socket) -> Any:
        if short.is_set():
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return accept(listener)

    monkeypatch.setattr(control.socket.socket, "accept", none_left)
    with capture_logs() as logs:
        server = ControlServer(tmp_path, handle)
        short.set()
        ask(tmp_path, {"command": "x"})  # the accept that was waiting already
        end = time.monotonic() + 5.0
        while not server.problem and time.monotonic() < end:
            time.sleep(0.01)
        assert server.problem == "the control socket answers nobody: Too many open files"
        short.clear()
        assert ask(tmp_path, {"command": "x"})
        assert server.problem == ""
        server.close()
    events = [line["event"] for line in logs]
    assert events == ["control_socket_starved", "control_socket_answers_again"]
