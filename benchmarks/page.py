"""Write docs/explanations/performance.md from loop.json: `python -m benchmarks.page`."""

import json
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.newcomer_page import newcomer
from benchmarks.page_text import HEAD, MISSED, TAIL
from benchmarks.summary import rate_name
from benchmarks.viewers_page import viewers

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "benchmarks/loop.json"
PAGE = ROOT / "docs/explanations/performance.md"

SERVERS = {
    "ours": "our soft IOC",
    "plain": "our soft IOC, `--plain`",
    "base": "EPICS base",
    "ours-arrays": "our soft IOC, arrays",
    "base-arrays": "EPICS base, arrays",
    "ours-pva": "our soft IOC, arrays over pvAccess",
    "base-pva": "EPICS base, arrays over pvAccess",
}
CLIENTS = {
    "service": "orbitfb, whole service",
    "ours": "orbitfb, loop alone",
    "plain": "PV.callback + PV.put",
    "lean": "the same, correctors not monitored",
}

Result = Mapping[str, Any]


def page(result: Result) -> str:
    """Return the page.

    Args:
        result: What `benchmarks.loop` wrote.
    """
    parts = [HEAD, _circumstances(result["about"]), _again(result["runs"])]
    parts += ["\n## Targets\n\n", _targets(result), MISSED]
    parts += ["\n## Every pair\n\n", LEGEND, _pairs(result["runs"])]
    parts += ["\n## Sixty seconds at 100 Hz\n\n", _long(result["long_runs"])]
    parts += ["\n## More PVs\n\n", SCALING, _scaling(result["scaling"], result["scaling_fit"])]
    parts += ["\n## Beside a swap and a refit\n\n", ADDED, _added(result["added_by"])]
    parts += ["\n## Beside viewers of the operator page\n\n", viewers()]
    parts += ["\n## From the clone to the first report\n\n", newcomer()]
    return "".join((*parts, TAIL))


LEGEND = """The table has medians over the repeats, in ms.

- *Round trip*, in lockstep: from one orbit to the next. The ring shows the next orbit as soon as
  the last setpoint for the one before is in force.
- *Round trip*, at a fixed rate: from the time stamp of the orbit to that of the last setpoint, as
  the server applied it.
- *Latency*: from the time stamp of the orbit until the client has sent the last setpoint.
- *Jitter*: 99th minus 1st percentile of the time between two writes.
- *Missed*: the due orbits that no setpoints answered, all repeats together.
- *CPU*: per tick.

The latency of a pair that falls behind means nothing. See what it missed.

"""

SCALING = """These runs are in lockstep, with a ring without physics and a law of linear cost. So
only Channel Access and the bookkeeping grow. The table has the round trip p50, medians over the
repeats.

"""

ADDED = """The whole service runs at 10 Hz. *Largest added*: the longest latency of any tick during
the disturbance, minus the median latency without one. Swaps come every 0.35 s. Refits run from
scratch on 2,000 ticks, one after the other without a pause.

"""


def _circumstances(about: Result) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in about["packages"].items())
    return (
        f"Measured {about['date']} by `{about['command']}` at commit {about['commit']}: "
        f"{about['repeats']} repeats, {about['cpus']} × {about['cpu']}, Linux {about['kernel']}, "
        f"Python {about['python']}, {versions}. Load average (1, 5, 15 minutes) before "
        f"{_list(about['load_before'])} and after {_list(about['load_after'])}; the benchmark "
        "itself contributes about 1.\n"
    )


def _again(rows: list[Result]) -> str:
    """Say which pairs were measured at another commit than the rest."""
    told = ""
    for commit in dict.fromkeys(row["commit"] for row in rows if "commit" in row):
        later = [row for row in rows if row.get("commit") == commit]
        pairs = dict.fromkeys((SERVERS[row["server"]], CLIENTS[row["client"]]) for row in later)
        which = ", ".join(f"{client} on {server}" for server, client in pairs)
        loads = [row["load_before"][0] for row in later]
        told += (
            f"\nMeasured again at commit {commit}, side by side, at a load average (1 minute) of "
            f"{min(loads):g} to {max(loads):g}: {which}.\n"
        )
    return told


def _list(values: list[float]) -> str:
    return " / ".join(f"{value:g}" for value in values)


def _targets(result: Result) -> str:
    ratios, added = result["ratios"], result["added_by"]
    base = ratios["our_ioc_over_base_our_loop"]
    plain = ratios["plain_client_over_service_on_our_ioc"]
    lean = ratios["lean_client_over_service_on_our_ioc"]
    fit = result["scaling_fit"]["ours"]
    rows = [
        ("plain loop ÷ service, our IOC, lockstep, p50", plain["lockstep"], "≥ 30", 30),
        ("the same, at 10 Hz", plain["10 Hz"], "", None),
        ("the same, lockstep, correctors not monitored", lean["lockstep"], "", None),
        ("missed in 60 s at 100 Hz, loop alone, all repeats", result["missed_at_100hz"], "0", -0),
        ("the same, whole service", result["missed_at_100hz_service"], "0", -0),
        ("torn orbits in both", result["torn_at_100hz"], "0", -0),
        ("our IOC ÷ EPICS base, our loop, lockstep, p50", base["lockstep"], "≤ 1.0", -1.0),
        ("the same, at 10 Hz", base["10 Hz"], "≤ 1.2", -1.2),
        ("the same, at 100 Hz", base["100 Hz"], "≤ 1.2", -1.2),
        ("µs per PV pair, largest ÷ smallest ring", _steepness(fit), "≤ 1", -1.0),
        ("added by a swap [ms]", added["swaps"]["largest_added_ms"], "< 50", -50.0),
        ("added by a running refit [ms]", added["refits"]["largest_added_ms"], "< 50", -50.0),
    ]
    for where, name in (("EPICS base", "base"), ("our IOC", "our_ioc")):
        for key, what in (("", ""), ("pva_", " over pvAccess")):
            if arrays := ratios.get(f"{key}arrays_over_scalars_on_{name}"):  # not in older files
                told = f"arrays{what} ÷ scalars, {where}, lockstep, p50"
                rows.append((told, arrays["lockstep"], "≤ 1.0", -1.0))
    lines = ["| what | measured | target | |", "|---|---|---|---|"]
    for what, value, target, bound in rows:
        shown = "–" if value is None else f"{value:g}"
        lines.append(f"| {what} | {shown} | {target} | {_verdict(value, bound)} |")
    return "\n".join(lines) + "\n"


def _steepness(fit: Result) -> float:
    return round(fit["last_us_per_pair"] / fit["first_us_per_pair"], 3)


def _verdict(value: float | None, bound: float | None) -> str:
    """Judge; a bound that is not positive is an upper one."""
    if bound is None:
        return ""
    if value is None:
        return "not measured"
    met = value >= bound if bound > 0 else value <= -bound
    return "met" if met else "**missed**"


def _pairs(rows: list[Result]) -> str:
    lines = [
        "| rate | server | client | round trip p50 | p99 | latency p50 | p99 | jitter | missed "
        "| torn | CPU server | client |",
        "|---" * 12 + "|",
    ]
    keys = dict.fromkeys((row["rate_hz"], row["server"], row["client"]) for row in rows)
    order = list(SERVERS), list(CLIENTS)
    ordered = sorted(
        keys, key=lambda key: (key[0] or 0.0, order[0].index(key[1]), order[1].index(key[2]))
    )
    for key in ordered:
        same = [row for row in rows if (row["rate_hz"], row["server"], row["client"]) == key]
        due = sum(row["ticks"] for row in same)
        missed = sum(row["missed"] or 0 for row in same)
        cells = [
            rate_name(key[0]),
            SERVERS[key[1]],
            CLIENTS[key[2]],
            *(_median(same, "round_trip_ms", name) for name in ("p50", "p99")),
            *(_median(same, "latency_ms", name) for name in ("p50", "p99")),
            _jitter(same),
            "" if key[0] is None else f"{missed} of {due + missed}" if missed else "0",
            str(sum(row["torn"] for row in same)),
            *(f"{median(r[n] for r in same):.2f}" for n in ("server_cpu_ms", "client_cpu_ms")),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _median(rows: list[Result], value: str, name: str) -> str:
    values = [row[value][name] for row in rows if row[value]]
    return f"{median(values):.2f}" if values else "–"


def _jitter(rows: list[Result]) -> str:
    values = [row["write_interval_ms"] for row in rows if row["write_interval_ms"]]
    return f"{median(v['p99'] - v['p1'] for v in values):.2f}" if values else "–"


def _long(rows: list[Result]) -> str:
    lines = [
        "| client | seed | load before | orbits | missed | torn | ticks held | round trip p50 "
        "| p99 | max |",
        "|---" * 10 + "|",
    ]
    for row in sorted(rows, key=lambda row: row["client"]):
        trip = row["round_trip_ms"] or {"p50": "–", "p99": "–", "max": "–"}
        cells = [
            CLIENTS[row["client"]],
            row["seed"],
            _list(row["load_before"]),
            row["ticks"],
            row["missed"],
            row["torn"],
            row["states"].get("HELD", 0),
            trip["p50"],
            trip["p99"],
            trip["max"],
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def _scaling(rows: list[Result], fit: Result) -> str:
    lines = [
        "| BPMs + correctors | our IOC [ms] | µs per pair | EPICS base [ms] | µs per pair |",
        "|---" * 5 + "|",
    ]
    for size in sorted({row["size"] for row in rows}):
        cells = [f"{size} + {size}"]
        for server in ("ours", "base"):
            p50 = median(
                row["round_trip_ms"]["p50"]
                for row in rows
                if row["size"] == size and row["server"] == server
            )
            cells += [f"{p50:.2f}", f"{p50 / size * 1e3:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    lines.append("")
    for server in ("ours", "base"):
        line = fit[server]
        lines.append(
            f"Straight line through the medians, {SERVERS[server]}: {line['fixed_ms']:.2f} ms + "
            f"{line['us_per_pair']:.2f} µs per pair; largest residual "
            f"{line['largest_residual_ms']:.2f} ms.\n"
        )
    return "\n".join(lines)


def _added(added: Result) -> str:
    words = {"nothing": "nothing", "swaps": "swaps of the policy", "refits": "refits"}
    lines = ["| beside the loop | largest added [ms] | missed |", "|---|---|---|"]
    lines += [
        f"| {words[kind]} | {figures['largest_added_ms']:.1f} | {figures['missed']} |"
        for kind, figures in added.items()
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    PAGE.write_text(page(json.loads(FIGURES.read_text(encoding="utf-8"))), encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
