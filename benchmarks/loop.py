"""Measure the loop on Channel Access: `python -m benchmarks.loop --out benchmarks/loop.json`.

Every run is one server process and one client process on this computer; runs of different kinds
alternate within a repeat, and the figures are medians over the repeats.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.circumstances import circumstances, load
from benchmarks.clients import Client, Run, measure
from benchmarks.servers import Server
from benchmarks.summary import summarise

Pair = tuple[Server, Client]
MAIN: list[Pair] = [
    ("ours", "service"),
    ("ours", "ours"),
    ("ours", "plain"),
    ("base", "ours"),
    ("ours-arrays", "ours"),
    ("base-arrays", "ours"),
    ("ours-pva", "ours"),
]
OTHERS: list[Pair] = [
    ("base-pva", "ours"),
    ("ours", "lean"),
    ("base", "plain"),
    ("plain", "ours"),
    ("plain", "plain"),
]
"""Measured at low rates alone: the plain ones fall behind at more than some 20 Hz."""
PAIRS: dict[float | None, list[Pair]] = {
    None: MAIN + OTHERS,
    10.0: MAIN + OTHERS,
    50.0: MAIN,
    100.0: MAIN,
}
SECONDS: dict[float | None, float] = {None: 2.0, 10.0: 5.0, 50.0: 3.0, 100.0: 3.0}
SIZES = (180, 500, 1000, 2000)
DISTURBANCES = ("nothing", "swaps", "refits")


def plan(repeats: int) -> Iterator[tuple[str, Run]]:
    """Give every run and the section of the file that it belongs to, in the order of running."""
    for repeat in range(repeats):
        seed = repeat + 1
        for rate, pairs in PAIRS.items():
            for server, client in _turned(pairs, repeat):
                yield "runs", Run(server, client, rate, SECONDS[rate], seed=seed)
        for client in ("ours", "service"):
            yield "long_runs", Run("ours", client, 100.0, 60.0, seed=seed)
        for size in SIZES:
            for server in ("ours", "base"):
                yield "scaling", Run(server, "ours", None, 2.0, size=size)
        for disturb in DISTURBANCES:
            yield (
                "disturbances",
                Run("ours", "service", 10.0, 15.0, disturb=disturb, seed=seed),
            )


def rehearsal() -> Iterator[tuple[str, Run]]:
    """Give one short run of every kind that the summary needs."""
    for server, client in MAIN:
        yield "runs", Run(server, client, None, 0.3, 0.2)
    for client in ("ours", "service"):
        yield "long_runs", Run("ours", client, 100.0, 0.3, 0.2)
    for size in (20, 60):
        for server in ("ours", "base"):
            yield "scaling", Run(server, "ours", None, 0.3, 0.2, size=size)
    for disturb in DISTURBANCES:
        yield "disturbances", Run("ours", "service", 10.0, 1.0, 0.2, disturb=disturb)


def _turned(pairs: list[Pair], by: int) -> list[Pair]:
    """Let no kind of run always come first."""
    by %= len(pairs)
    return pairs[by:] + pairs[:by]


def run_all(repeats: int, quick: bool, command: str) -> dict[str, Any]:
    """Measure everything and return what goes into the file."""
    result: dict[str, Any] = {"about": circumstances(command, repeats, quick)}
    sections: dict[str, list[dict[str, Any]]] = {
        name: [] for name in ("runs", "long_runs", "scaling", "disturbances")
    }
    failed: list[dict[str, Any]] = []
    todo = list(rehearsal() if quick else plan(repeats))
    for number, (section, run) in enumerate(todo, 1):
        before = load()
        figures = _measured(run, failed)
        if figures is None:
            continue
        figures["load_before"] = before
        sections[section].append(figures)
        trip = figures["round_trip_ms"]
        rate = f"{run.rate_hz:g} Hz" if run.rate_hz else "lockstep"
        print(
            f"{number}/{len(todo)} {section} {run.server} server, {run.client} client, {rate}"
            f"{f', {run.size} + {run.size}' if run.size else ''}: "
            f"{figures['ticks']} ticks, p50 {trip['p50'] if trip else '-'} ms, "
            f"missed {figures['missed']}, torn {figures['torn']}",
            flush=True,
        )
    result["about"]["load_after"] = load()
    return {**summarise(sections), "failed": failed, **result, **sections}


def _measured(run: Run, failed: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Measure, once more if it fails; every failure is kept for the file."""
    for attempt in range(2):
        try:
            return measure(run)
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            failed.append({**asdict(run), "attempt": attempt, "error": str(error)[-500:]})
            print(f"FAILED: {run}: {error}", flush=True)
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--repeats", type=int, default=3, help="of everything; 3 by default")
    parser.add_argument("--quick", action="store_true", help="fractions of a second: a rehearsal")
    options = parser.parse_args()
    repeats = 1 if options.quick else options.repeats
    command = " ".join(["python -m benchmarks.loop", *sys.argv[1:]])
    result = run_all(repeats, options.quick, command)
    options.out.write_text(dump(result), encoding="utf-8")
    for name, value in result.items():
        if isinstance(value, int | float):
            print(f"{name}: {value}")
    if result["failed"]:
        sys.exit(f"{len(result['failed'])} runs failed; see `failed` in {options.out}")


def dump(result: dict[str, Any]) -> str:
    """Write the file: a line for every run."""
    lines = []
    for name, value in result.items():
        if isinstance(value, list):
            rows = ",\n".join(f"    {json.dumps(row)}" for row in value)
            lines.append(f"  {json.dumps(name)}: [\n{rows}\n  ]")
        else:
            text = json.dumps(value, indent=2).replace("\n", "\n  ")
            lines.append(f"  {json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    main()
