"""The tutorial is run as it stands: its commands in a shell, its Python as programs.

A `console` block has commands after `$ ` and below each the output to expect. Commands of a page
share one shell, in an empty directory, on free ports. Numbers, ids and spaces of the output may
differ, `…` stands for anything, an output line that is only `…` for any number of lines; lines
must come in their order. A `python` block is a program that must succeed. A `text` block is not
looked at. A comment before a block says what else holds, several things separated by `;`:

    <!-- test: skip, REASON -->             do not run the block
    <!-- test: background -->               run its command in another terminal
    <!-- test: wait 5 -->                   first wait so many seconds
    <!-- test: replace "A" by "B" -->       run B where the page says A
    <!-- test: output -->                   this `text` block is what the last program printed

and, by itself, `<!-- test: stop -->` presses Ctrl-C in the other terminal.
"""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))
LONG = {"find-the-cause": (pytest.mark.slow, pytest.mark.timeout(600))}
"""Marks of pages that take more than half a minute."""
PIECE = re.compile(r"(?:<!-- test: (?P<orders>[^>]*?) -->\n)?```(?P<kind>\w+)\n(?P<body>.*?)```\n"
                   r"|<!-- test: (?P<alone>stop) -->", re.DOTALL)  # fmt: skip
NUMBER = r"[-+]?\d[\d.:]*(?:e[-+]?\d+)?"
VARIABLE = re.compile(rf"(?:svd|modal)-[0-9a-f]{{12}}|\d{{4}}-\d\d-\d\dT\S+|{NUMBER}")
END = "__end_of_command__"


@dataclass(frozen=True)
class Piece:
    """A block of a page with its orders."""

    kind: str
    body: str
    orders: tuple[str, ...]

    def order(self, word):
        """What follows a word among the orders; None if it is not there."""
        found = [order for order in self.orders if order.split(",")[0].split(" ")[0] == word]
        return found[0].removeprefix(word).strip() if found else None


def pieces(page):
    for found in PIECE.finditer(page.read_text(encoding="utf-8")):
        if found["alone"]:
            yield Piece("stop", "", ())
        else:
            orders = tuple(o.strip() for o in (found["orders"] or "").split(";"))
            yield Piece(found["kind"], found["body"], orders)


def commands(body):
    """Commands of a block, each with the lines shown below it."""
    shown = []
    for line in body.splitlines():
        if line.startswith("$ "):
            shown.append((line.removeprefix("$ "), []))
        else:
            shown[-1][1].append(line)
    return shown


def pattern(line):
    """What a shown line allows: other numbers, other ids, other spaces."""
    parts = []
    for part in re.split(rf"(…|{VARIABLE.pattern}|\s+)", line.strip()):
        if part == "…":
            parts.append(".*")
        elif VARIABLE.fullmatch(part or " "):
            parts.append(rf"(?:{VARIABLE.pattern})")
        else:
            parts.append(r"\s+" if part and part.isspace() else re.escape(part))
    return re.compile("".join(parts))


def missing_line(shown, output):
    """The first shown line that the output does not have in its place; None if it has all."""
    printed, at = output.splitlines(), 0
    for line in shown:
        if line.strip() in ("", "…"):
            continue
        allowed = pattern(line)
        while at < len(printed) and not allowed.fullmatch(printed[at].strip()):
            at += 1
        if at == len(printed):
            return line
        at += 1
    return None


class Shell:
    """One bash that keeps its directory and its variables."""

    def __init__(self, directory, environment):
        self._bash = subprocess.Popen(
            ["bash", "--noprofile", "--norc"],
            cwd=directory,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, command):
        """Run a command and return all that it printed."""
        self._bash.stdin.write(f"{command}\necho; echo {END}\n")
        self._bash.stdin.flush()
        printed = []
        for line in self._bash.stdout:
            if line.strip() == END:
                return "".join(printed)
            printed.append(line)
        raise AssertionError(f"the shell ended in: {command}\n{''.join(printed)}")

    def close(self):
        self._bash.stdin.close()
        self._bash.wait(10)
        self._bash.stdout.close()


def free_ports(count):
    """Ports that are free for TCP and UDP now."""
    with contextlib.ExitStack() as stack:
        ports = []
        while len(ports) < count:
            tcp = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            udp = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            tcp.bind(("127.0.0.1", 0))
            with contextlib.suppress(OSError):
                udp.bind(tcp.getsockname())
                ports.append(tcp.getsockname()[1])
        return ports


class Session:
    """Both terminals of a reader."""

    def __init__(self, directory, stack):
        ioc, metrics = free_ports(2)
        self.directory = directory
        self.ports = {"15064": str(ioc), "9180": str(metrics)}
        # The path of a Unix socket is short, that of a test's directory may not be.
        runtime = stack.enter_context(tempfile.TemporaryDirectory(prefix="docs-"))
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("EPICS_", "ORBITFB_"))}
        self.environment = clean | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "ORBITFB_SIM__PORT": str(ioc),
            "ORBITFB_OBSERVE__PORT": str(metrics),
            "XDG_RUNTIME_DIR": runtime,
            "PYTHONUNBUFFERED": "1",
        }
        self._stack = stack
        self.shell = Shell(directory, self.environment)
        stack.callback(self.shell.close)
        self.background = None
        self.printed = ""

    def here(self, text, piece):
        """Put the ports of this test, and what the page's author asked for, into a command."""
        for order in piece.orders:
            if found := re.fullmatch(r'replace "(.*)" by "(.*)"', order):
                assert found[1] in text, f"nothing to replace: {order}"
                text = text.replace(found[1], found[2])
        for page, test in self.ports.items():
            text = text.replace(page, test)
        return text

    def start(self, command):
        output = self._stack.enter_context((self.directory / "background.txt").open("w+"))
        self.background = subprocess.Popen(
            f"exec {command}", shell=True, cwd=self.directory, env=self.environment, stdout=output,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        self._stack.callback(self.kill)

    def kill(self):
        if self.background is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.background.pid, signal.SIGKILL)
            self.background.wait()

    def stop(self):
        os.killpg(self.background.pid, signal.SIGINT)
        code = self.background.wait(10)
        assert code == 0, (self.directory / "background.txt").read_text()

    def do(self, piece):
        """Do what a piece of the page says and compare."""
        if piece.kind == "stop":
            self.stop()
        elif piece.kind == "text" and piece.order("output") is not None:
            line = missing_line(piece.body.splitlines(), self.printed)
            assert line is None, f"the page shows\n{line}\nbut it printed\n{self.printed}"
        elif piece.kind == "python":
            done = subprocess.run(
                [sys.executable, "-W", "error", "-c", piece.body], cwd=self.directory, text=True,
                env=self.environment, capture_output=True, timeout=60, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            self.printed = done.stdout
        elif piece.kind == "console" and piece.order("skip") is None:
            time.sleep(float(piece.order("wait") or 0))
            for command, shown in commands(piece.body):
                command = self.here(command, piece)
                if piece.order("background") is not None:
                    self.start(command)
                    continue
                output = self.shell.run(command)
                line = missing_line(shown, output)
                assert line is None, f"$ {command}\nthe page shows\n{line}\nbut\n{output}"


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, id=page.stem, marks=LONG.get(page.stem, ())) for page in TUTORIALS],
)
def test_tutorial_does_what_it_says(page, tmp_path):
    with contextlib.ExitStack() as stack:
        session = Session(tmp_path, stack)
        done = [session.do(piece) for piece in pieces(page)]
    assert len(done) > 1


def test_make_run_is_the_command_that_stands_in_for_it():
    run = (ROOT / "Makefile").read_text().split("\nrun:")[1].split("\n\n")[0]
    assert run.strip().endswith("orbitfb run --ioc sim")


def test_shown_lines_allow_other_numbers_and_nothing_else():
    assert missing_line(["state   CLOSED", "rms 0.2 µm"], "x\nstate CLOSED\nrms 14 µm") is None
    assert missing_line(["state   CLOSED"], "state HELD") == "state   CLOSED"
    assert missing_line(["b 1", "a 1"], "a 1\nb 2") == "a 1"
    assert missing_line(["policy svd-0123456789ab"], "policy svd-ba9876543210") is None
    assert missing_line(["reason …", "…", "end"], "reason any 3\nmore\nend") is None
