"""The terminals of somebody who does what a page says, in an empty directory, on free ports."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from docs_pieces import COMMANDS, commands, file_name
from free_ports import free_port

NUMBER = r"[-+]?\d[\d.:]*(?:e[-+]?\d+)?"
VARIABLE = re.compile(rf"(?:svd|modal)-[0-9a-f]{{12}}|\d{{4}}-\d\d-\d\dT\S+|{NUMBER}")
PATIENCE = 60.0
"""How long `until` tries [s]."""
END = "__end_of_command__"
PORTS = {"15064": "SIM", "9180": "OBSERVE", "15074": "PANEL", "9181": "WEB"}
"""Ports that pages name -> the section that has it as `port`."""


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
            ["bash", "--noprofile", "--norc", "-o", "pipefail"],
            cwd=directory,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, command):
        """Run a command; its exit code and all that it printed."""
        self._bash.stdin.write(f"{command}\ncode=$?; echo; echo {END} $code\n")
        self._bash.stdin.flush()
        printed = []
        for line in self._bash.stdout:
            if line.startswith(END):
                return int(line.split()[1]), "".join(printed)
            printed.append(line)
        raise AssertionError(f"the shell ended in: {command}\n{''.join(printed)}")

    def close(self):
        self._bash.stdin.close()
        self._bash.wait(10)
        self._bash.stdout.close()


class Session:
    """The terminals of a reader.

    Args:
        directory: An empty one.
        stack: Ends what was started.
    """

    def __init__(self, directory, stack, watch=True):
        self.directory = directory
        self.ports = {page: str(free_port()) for page in PORTS}
        # The path of a Unix socket is short, that of a test's directory may not be.
        runtime = stack.enter_context(tempfile.TemporaryDirectory(prefix="docs-"))
        clean = {k: v for k, v in os.environ.items() if not k.startswith("ORBITFB_")}
        self.environment = clean | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "EPICS_CA_SERVER_PORT": self.ports["15064"],
            "XDG_RUNTIME_DIR": runtime,
            "PYTHONUNBUFFERED": "1",
        }
        for port, section in PORTS.items():
            self.environment[f"ORBITFB_{section}__PORT"] = self.ports[port]
        if not watch:  # half a minute of computing beside a loop
            self.environment["ORBITFB_DIAGNOSE__LIVE__ENABLED"] = "false"
        self._stack = stack
        self.shell = Shell(directory, self.environment)
        stack.callback(self.shell.close)
        self.others = []
        self.printed = ""

    def here(self, text, piece):
        """Put the ports of this test, and what the page's author asked for, into a text."""
        for order in piece.orders:
            if found := re.fullmatch(r'replace "(.*)" by "(.*)"', order):
                assert found[1] in text, f"nothing to replace: {order}"
                text = text.replace(found[1], found[2])
        for page, test in self.ports.items():
            text = re.sub(rf"\b{page}\b", test, text)
        return text.replace(".venv/bin/", "")

    def start(self, command):
        """Run a command in another terminal."""
        output = self.directory / f"terminal-{len(self.others)}.txt"
        with output.open("w") as file:
            terminal = subprocess.Popen(
                f"exec {command}", shell=True, cwd=self.directory, env=self.environment,
                stdout=file, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        self.others.append((terminal, output))
        self._stack.callback(self.kill, terminal)

    @staticmethod
    def kill(terminal):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(terminal.pid, signal.SIGKILL)
        terminal.wait()

    def stop(self):
        """Press Ctrl-C in the last of the other terminals."""
        terminal, output = self.others.pop()
        assert terminal.poll() is None, output.read_text()
        os.killpg(terminal.pid, signal.SIGINT)
        code = terminal.wait(10)
        assert code == 0, output.read_text()

    def write(self, piece):
        """Write the file that a block is."""
        text = self.here(piece.body, piece)
        (self.directory / file_name(piece.body)).write_text(text, encoding="utf-8")

    def do(self, piece):
        """Do what a piece of the page says and compare."""
        if piece.order("skip") is not None:
            return
        time.sleep(float(piece.order("wait") or 0))
        if piece.kind == "alone":
            self._alone(piece)
        elif piece.kind == "toml":
            self.write(piece)
        elif piece.kind == "text" and piece.order("output") is not None:
            self._compare(piece.body.splitlines(), self.printed, "python")
        elif piece.kind == "python":
            self._program(self.here(piece.body, piece))
        elif piece.kind in COMMANDS:
            for command, shown in commands(self.here(piece.body, piece)):
                if piece.order("background") is not None:
                    self.start(command)
                else:
                    self._command(command, shown)

    def _alone(self, piece):
        if piece.order("stop") is not None:
            self.stop()
        elif (command := piece.order("start")) is not None:
            self.start(self.here(command, piece))
        elif (command := piece.order("run")) is not None:
            self._command(self.here(command, piece), None)
        elif (command := piece.order("until")) is not None:
            deadline = time.monotonic() + PATIENCE
            while self.shell.run(self.here(command, piece))[0] != 0:
                assert time.monotonic() < deadline, f"not yet: {command}\n{self._elsewhere()}"
                time.sleep(0.2)

    def _program(self, text):
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", text], cwd=self.directory, text=True,
            env=self.environment, capture_output=True, timeout=60, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        self.printed = done.stdout

    def _command(self, command, shown):
        begin = time.monotonic()
        code, output = self.shell.run(command)
        print(f"{time.monotonic() - begin:6.1f} s  {command}")  # pytest shows it on failure
        if shown is None:
            assert code == 0, f"$ {command}\nended with {code}\n{output}{self._elsewhere()}"
        else:
            self._compare(shown, output, command)

    def _compare(self, shown, output, command):
        line = missing_line(shown, output)
        assert line is None, (
            f"$ {command}\nthe page shows\n{line}\nbut\n{output}{self._elsewhere()}"
        )

    def _elsewhere(self):
        return "".join(f"\n{file.name}:\n{file.read_text()[-3000:]}" for _, file in self.others)
