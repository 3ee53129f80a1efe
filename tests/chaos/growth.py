"""Whether a process grows: its memory, its file descriptors, its threads."""

import time
from dataclasses import dataclass, field

import numpy as np
import psutil

MEGABYTE = 1 << 20
MEMORY, FILES, THREADS = 24.0, 4, 2
"""What may come and go between the first and the last part of a life [MB, 1, 1]."""
SETTLED = 60.0
"""Time after a start in which buffers fill [s]."""


@dataclass
class Life:
    """Samples of one process."""

    pid: int
    rows: list[tuple[float, float, int, int]] = field(default_factory=list)

    def sample(self) -> None:
        """Look once."""
        try:
            process = psutil.Process(self.pid)
            with process.oneshot():
                memory = process.memory_info().rss / MEGABYTE
                self.rows.append(
                    (time.monotonic(), memory, process.num_fds(), process.num_threads())
                )
        except psutil.Error:
            return

    @property
    def seconds(self) -> float:
        """How long it was watched [s]."""
        return self.rows[-1][0] - self.rows[0][0] if self.rows else 0.0

    def figures(self, settled: float = SETTLED) -> dict[str, float]:
        """Compare the medians of the first and the last fifth after it has settled."""
        rows = np.array([row for row in self.rows if row[0] - self.rows[0][0] >= settled])
        if len(rows) < 10:
            return {}
        part = max(2, len(rows) // 5)
        first, last = np.median(rows[:part], axis=0), np.median(rows[-part:], axis=0)
        names = ("memory_mb", "files", "threads")
        figures = {"seconds": float(rows[-1, 0] - rows[0, 0])}
        for column, name in enumerate(names, start=1):
            figures[f"{name}_first"] = float(first[column])
            figures[f"{name}_last"] = float(last[column])
        return figures


def grown(figures: dict[str, float], memory: float = MEMORY) -> list[str]:
    """Say what grew beyond what may."""
    if not figures:
        return []
    most = {"memory_mb": memory, "files": FILES, "threads": THREADS}
    return [
        f"{name} grew from {figures[f'{name}_first']:.1f} to {figures[f'{name}_last']:.1f}"
        for name, limit in most.items()
        if figures[f"{name}_last"] - figures[f"{name}_first"] > limit
    ]
