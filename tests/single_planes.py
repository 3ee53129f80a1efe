"""A ring whose correctors act in one plane each, some in pairs at one s; one BPM reads x alone."""

import csv
import io
import json
from importlib import resources
from pathlib import Path

PAIRED = "CH1A"
"""Correctors that are two rows at one s: H and V."""
X_ONLY = "PH1A_C10"
"""The BPM that reads x alone."""
OF_X = ("cal_x_rad_per_A", "pv_x", "rb_x")
OF_Y = ("cal_y_rad_per_A", "pv_y", "rb_y")


def write_ring(directory: Path) -> tuple[Path, Path]:
    """Write its table and its parameters; gives both files."""
    data = resources.files("orbitfb") / "data"
    rows = list(csv.DictReader(io.StringIO((data / "places.csv").read_text(encoding="utf-8"))))
    made: list[dict[str, str]] = []
    number = 0
    for row in rows:
        if row["kind"] == "COR":
            number += 1
            halves = [("H", OF_Y), ("V", OF_X)]
            if not row["name"].startswith(PAIRED):
                halves = [("", OF_Y if number % 2 else OF_X)]
            for letter, gone in halves:
                its = {**row, "name": row["name"] + letter, **dict.fromkeys(gone, "")}
                made.append(its)
            continue
        made.append({**row, "pv_y": ""} if row["name"] == X_ONLY else row)
    places, parameters = directory / "places.csv", directory / "ring.json"
    with places.open("w", newline="") as file:
        writer = csv.DictWriter(file, [*rows[0]])
        writer.writeheader()
        writer.writerows(made)
    ring = json.loads((data / "ring.json").read_text(encoding="utf-8"))
    ring.pop("counts", None)
    parameters.write_text(json.dumps(ring))
    return places, parameters
