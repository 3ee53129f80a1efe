"""What a campaign found, for people and for programs."""

import json
from pathlib import Path
from typing import Any


def markdown(result: dict[str, Any]) -> str:
    """Write the counts of both loops side by side."""
    naive = result.get("naive")
    hours = result["ours"]["ring hours at 10 Hz"]
    ours, beside = result["ours"], " |" if naive else ""
    lines = [
        f"{result['faults']} faults in {result['episodes']} episodes, seed {result['seed']}: "
        f"{ours['ticks']} orbits at {result['rate_hz']:g} Hz in {result['seconds']:.0f} s, as many "
        f"as a ring at 10 Hz shows in {hours:.2f} h.",
        "",
        "| | orbitfb | plain loop |" if naive else "| | orbitfb |",
        "|---|---:|---:|" if naive else "|---|---:|",
    ]
    for name, value in ours.items():
        if name not in ("ticks", "ring hours at 10 Hz"):
            lines.append(f"| {name} | {value} |" + (f" {naive[name]} |" if naive else ""))
    if naive:
        by_hand = result["counts"].get("opened and closed by hand", 0)
        by_hand += result["counts"].get("closed by hand", 0) + result["counts"].get("tripped", 0)
        lines.append(f"| closed or started again by hand | {by_hand} | {result['naive_again']} |")
    lines += [
        f"| HELD | {result['held']} |" + beside,
        f"| TRIPPED, each with its reason and post-mortem | {result['tripped']} |" + beside,
        f"| trips not explained | {result['unexplained']} |" + beside,
        "",
        f"Back to CLOSED after {result['recovery_p50_s']} s (median), "
        f"{result['recovery_longest_s']} s (longest), the steps of an operator included.",
    ]
    if growth := result["growth"]:
        lines.append(
            f"In a life of {growth['seconds']:.0f} s: memory {growth['memory_mb_first']:.0f} to "
            f"{growth['memory_mb_last']:.0f} MB, file descriptors {growth['files_first']:.0f} to "
            f"{growth['files_last']:.0f}, threads {growth['threads_first']:.0f} to "
            f"{growth['threads_last']:.0f}."
        )
    lines += ["", "Rules broken: " + ("none." if not result["broken"] else "")]
    lines += [f"- {problem}" for problem in result["broken"]]
    return "\n".join(lines) + "\n"


def write(result: dict[str, Any], out: Path | None) -> str:
    """Write both files, if there is a place for them; gives the table."""
    text = markdown(result)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "chaos.json").write_text(json.dumps(result, indent=1) + "\n")
        (out / "chaos.md").write_text(text)
    return text


def verdict(result: dict[str, Any]) -> int:
    """Give the exit code."""
    return 1 if result["broken"] else 0
