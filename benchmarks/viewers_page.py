"""The section on viewers of the page on performance, from viewers.json."""

import json
from pathlib import Path
from typing import Any

import numpy as np

FIGURES = Path(__file__).parent / "viewers.json"

WORDS = {
    "process": "its own process",
    "thread": "a thread of the loop's",
}

TEXT = """The table has the latency of every tick at {rate:g} Hz in ms, from the archive: from the
time stamp of an orbit until the last setpoint was sent. The viewers (*company*) change every
{seconds:g} s within one service, and the two services alternate. A stalled viewer opens the page
and reads nothing. Viewers that read have the lowest priority, because in operation they run on
other computers. *p99 of runs*: the p99 of each run with the same company. *CPU*: of the loop's
process, all threads, in ms per second.

"""

AFTER = """
The page asks the service for every picture once and encodes it once, for any number of viewers.
This costs the loop's process CPU time, in ms per second:

- {process};
- {thread}.

A page in a thread holds the interpreter's lock while it encodes and sends, longer with each
viewer. So the page has its own process. There the p99 with any company is at most {added:.1f} ms
above the p99 without a viewer. Two runs with the same company differ by up to {scatter:.1f} ms, so
a smaller difference means nothing.

`.venv/bin/{command}` measures it.
"""
COSTS = "{}: {} without a viewer, {} with one, {} with ten, {} with one that stalls"


def viewers() -> str:
    """Return the section, without its heading."""
    result: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8"))
    about = result["about"]
    lines = [
        "| page served from | company | ticks | p50 | p99 | p99 of runs | max | CPU [ms/s] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for place, words in WORDS.items():
        for kind, row in result[place].items():
            runs = " / ".join(f"{value:.1f}" for value in row["p99_ms_of_runs"])
            lines.append(
                f"| {words} | {kind} | {row['ticks']} | {row['p50_ms']:.2f} | {row['p99_ms']:.1f} "
                f"| {runs} | {row['max_ms']:.1f} | {row['cpu_ms_per_s']:.1f} |"
            )
    loads = [
        " / ".join(f"{value:g}" for value in about[key]) for key in ("load_before", "load_after")
    ]
    moment = (
        f"Measured {about['date']} at commit {about['commit']}, {about['cpus']} × {about['cpu']}, "
        f"load average (1, 5, 15 minutes) before {loads[0]} and after {loads[1]}.\n\n"
    )
    text = TEXT.format(rate=result["rate_hz"], seconds=result["seconds"])
    costs = {
        place: COSTS.format(
            words, *(f"{row['cpu_ms_per_s']:.0f}" for row in result[place].values())
        )
        for place, words in WORDS.items()
    }
    alone, *others = result["process"].values()
    added = max(row["p99_ms"] for row in others) - alone["p99_ms"]
    scatter = max(float(np.ptp(row["p99_ms_of_runs"])) for row in result["process"].values())
    end = AFTER.format(**costs, added=added, scatter=scatter, command=about["command"])
    return text + moment + "\n".join(lines) + "\n" + end
