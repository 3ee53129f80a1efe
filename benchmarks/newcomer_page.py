"""What `make newcomer` measured, for the page on performance."""

import json
from pathlib import Path

FIGURES = Path(__file__).with_name("newcomer.json")
AIM = 300.0
"""From the clone to the first report [s]."""

INTRODUCTION = """`make newcomer` clones the last commit and follows the README in an empty home
directory, with nothing downloaded before. It writes down when each step was done
([benchmarks/newcomer.json](../../benchmarks/newcomer.json)):

| reached | after [s] |
|---|---|
"""


def newcomer() -> str:
    """Write the section."""
    told = json.loads(FIGURES.read_text(encoding="utf-8"))
    seconds = told["seconds"]
    rows = "".join(f"| {name} | {value:.0f} |\n" for name, value in seconds.items())
    verdict = "met" if seconds["first diagnosis report"] <= AIM else "missed"
    load = f"{told['cpus']} processors had a load of {told['load_before'][0]:.0f} before it began"
    source = (
        "; pip found wheels on the disk of this computer, so it downloaded less than it would "
        "elsewhere"
        if told["wheels_from_this_disk"]
        else ""
    )
    return (
        f"{INTRODUCTION}{rows}\nThe aim is five minutes. This run {verdict} it; {load}. "
        f"{told['installed']} packages, {told['torch']}{source}.\n"
    )
