"""A table of places whose devices are elements of arrays."""

import csv
import io
from importlib.resources import files
from pathlib import Path

COLUMNS = {
    ("BPM", "pv_x"): "SR:Orbit{}-I",
    ("COR", "pv_x"): "SR:Currents{}-SP",
    ("COR", "rb_x"): "SR:Currents{}-I",
}
"""Arrays by kind of place and column; the braces stand for the plane."""


def array_places(file: Path, over: str = "") -> Path:
    """Write the default ring's table with one array for all devices of a kind and plane.

    Args:
        file: To write.
        over: What their names begin with: `pva://`, or nothing for Channel Access.
    """
    text = (files("orbitfb") / "data" / "places.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text)))
    counts: dict[str, int] = {}
    for row in rows:
        for (kind, column), pattern in COLUMNS.items():
            for plane in "xy":
                its = column[:-1] + plane
                if row["kind"] == kind and row[its]:
                    name = over + pattern.format("{" + plane.upper() + "}")
                    row[its] = f"{name}.[{counts.get(name, 0)}]"
                    counts[name] = counts.get(name, 0) + 1
    with file.open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return file
