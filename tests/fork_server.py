"""A process that has imported the program, and forks: each of its children is a start of it.

    python -W error::ResourceWarning tests/fork_server.py DESCRIPTOR

A start computes for one to two seconds, nearly all of them imports and the reading of the ring that
comes with the program, and the tests start the program more than a hundred times. What a child does
is what `python -m orbitfb` does after its imports, in a session, an environment and files of its
own, or what the script of a client does, which most often imports pyepics. `make nightly` starts
all of them anew instead.

The descriptor is that of a socket. A request is one message: arguments, environment and script as
JSON, with the descriptors of standard output, standard error and of a pipe. The pipe gets the
number of the process, then a line about its end: what `waitpid` says, and the CPU seconds it took.
"""

import array
import contextlib
import json
import os
import select
import signal
import socket
import sys

import epics  # noqa: F401

import orbitfb.app.doctor.examine
import orbitfb.app.measure.command
import orbitfb.app.service.run
import orbitfb.cli.app
import orbitfb.observe.http
from orbitfb.physics.places import Ring
from orbitfb.sim.environment import server_environment

os.environ.update(server_environment(plain=False))
import orbitfb.sim.server  # caproto reads the environment when it is imported

Ring.load()
LONGEST = 1 << 20
"""Longest request [bytes]: the environment is in it."""


def receive(control: socket.socket) -> tuple[dict[str, object], list[int]] | None:
    """Take a request and its descriptors; None: whoever asked is gone."""
    space = socket.CMSG_SPACE(3 * array.array("i").itemsize)
    data, ancillary, _, _ = control.recvmsg(LONGEST, space)
    if not data:
        return None
    descriptors = array.array("i")
    for _, _, content in ancillary:
        descriptors.frombytes(content[: len(content) - len(content) % descriptors.itemsize])
    return json.loads(data), descriptors.tolist()


def reap(pipes: dict[int, int]) -> None:
    """Tell of the children that have ended."""
    while pipes:
        pid, status, used = os.wait4(-1, os.WNOHANG)
        if pid == 0:
            return
        pipe = pipes.pop(pid)
        with contextlib.suppress(BrokenPipeError):  # nobody wants to know any more
            os.write(pipe, f"{status} {used.ru_utime + used.ru_stime}\n".encode())
        os.close(pipe)


def serve(control: socket.socket) -> str:
    """Fork at each request; returns in the children alone, with the script if there is one."""
    wake, alarm = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(alarm, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the tests, which end it
    pipes: dict[int, int] = {}
    while True:
        ready, _, _ = select.select([control, wake], [], [])
        if wake in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(wake, 4096)
            reap(pipes)
        if control not in ready:
            continue
        if (request := receive(control)) is None:
            control.close()
            sys.exit()
        asked, (out, err, pipe) = request
        if (pid := os.fork()) != 0:
            os.write(pipe, f"{pid}\n".encode())
            pipes[pid] = pipe
            os.close(out)
            os.close(err)
            continue
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for left in (wake, alarm, pipe, *pipes.values()):
            os.close(left)
        control.close()
        begin(asked, out, err)
        return str(asked["script"])


def begin(asked: dict[str, object], out: int, err: int) -> None:
    """Be the process that was asked for."""
    os.setsid()
    os.dup2(out, 1)
    os.dup2(err, 2)
    os.close(out)
    os.close(err)
    arguments, environment = asked["arguments"], asked["environment"]
    assert isinstance(arguments, list) and isinstance(environment, dict)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [orbitfb.__file__.replace("__init__", "__main__"), *arguments]


if __name__ == "__main__":
    if script := serve(socket.socket(fileno=int(sys.argv[1]))):
        exec(compile(script, "<client>", "exec"), {"__name__": "__main__"})
    else:
        __package__ = "orbitfb"  # as `python -m orbitfb` has it: usage names the program by it
        orbitfb.cli.app.main()
