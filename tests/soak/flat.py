"""What flat means, and the figures of a soak."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

LATENCY_FACTOR, LATENCY_FLOOR = 1.25, 2e-3
"""Growth of the p99 of a latency that is none, and the difference that is none [s]."""


@dataclass(frozen=True)
class Soak:
    """Figures of one soak, first part and last part; `lost`: orbits missed, or not archived."""

    what: str
    ticks: int
    hours: float
    seconds: float
    memory_mb: tuple[float, float]
    files: tuple[float, float]
    threads: tuple[float, float]
    p99_ms: tuple[float, float]
    p50_ms: tuple[float, float]
    lost: int = 0
    notes: str = ""

    def problems(self, memory: float) -> list[str]:
        """Say what is not flat.

        Args:
            memory: Growth between the parts that is none [MB].
        """
        found = []
        for name, (first, last), most in (
            ("memory_mb", self.memory_mb, memory),
            ("files", self.files, 2.0),
            ("threads", self.threads, 1.0),
        ):
            if not last - first <= most:
                found.append(f"{self.what}: {name} {first:.1f} -> {last:.1f}, more than {most:g}")
        first, last = self.p99_ms
        if not (last <= first * LATENCY_FACTOR or last - first <= LATENCY_FLOOR * 1e3):
            found.append(f"{self.what}: p99 {first:.2f} -> {last:.2f} ms")
        if self.lost:
            found.append(f"{self.what}: {self.lost} orbits lost")
        return found

    def row(self) -> dict[str, Any]:
        """Give the figures as JSON has them."""
        return asdict(self)

    def lines(self) -> list[str]:
        """Give the figures for people."""
        pairs = {
            "memory [MB]": self.memory_mb,
            "file descriptors": self.files,
            "threads": self.threads,
            "latency p50 [ms]": self.p50_ms,
            "latency p99 [ms]": self.p99_ms,
        }
        head = (
            f"{self.what}: {self.ticks} ticks, {self.hours:.2f} h of the ring, {self.seconds:.0f} s"
        )
        figures = (f"  {n:18} {a:9.3f} -> {b:9.3f}" for n, (a, b) in pairs.items())
        return [head, *figures, f"  {'orbits lost':18} {self.lost:9d}"]


def first_and_last(values: np.ndarray, part: int, which: Any) -> tuple[float, float]:
    """Apply a figure to the first and the last part of a series."""
    return float(which(values[:part])), float(which(values[-part:]))
