"""A second controller, on another account: no lock of a file keeps it out, only the lease."""

from collections.abc import Sequence
from pathlib import Path

from tests.chaos.rings import Side, wait

REFUSED = "is under the control of"
"""What it must say of the lease of the first."""


class Second:
    """`orbitfb run --start closed` at a ring that has its controller.

    Args:
        command: Of the first one.
        directory: For its data and what it prints; it is also where its locks lie.
        port: Of the ring.
    """

    def __init__(self, command: Sequence[object], directory: Path, port: int) -> None:
        directory.mkdir()
        words = [str(word) for word in command]
        words[words.index("--data") + 1] = str(directory / "data")
        self._command, self._directory, self._port = words, directory, port
        self._side: Side | None = None

    def start(self) -> None:
        """Start it, beside whatever of it still runs."""
        if self._side is None:
            self._side = Side(
                self._command,
                self._directory,
                self._port,
                environment={"XDG_RUNTIME_DIR": str(self._directory)},
            )
        elif not self._side.alive:
            self._side.start()

    def end(self, timeout: float = 0.0) -> tuple[str, str]:
        """Wait until it has ended by itself; kill it if it does not.

        Args:
            timeout: How long to wait [s].

        Returns:
            What became of it: `` (there was none), `refused`, `ended` or `runs`; and its words.
        """
        side, self._side = self._side, None
        if side is None:
            return "", ""
        ended = wait(lambda: not side.alive, timeout, 0.1)
        side.kill()
        told = side.errors().strip()
        if not ended:
            return "runs", side.output().strip()[-300:]
        refused = side.popen.returncode != 0 and REFUSED in told
        return ("refused" if refused else "ended"), told[-300:]
