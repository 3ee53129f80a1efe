"""Score answers against the truth: a process of its own, the only one that opens the truth.

    python -m tests.blind.score --truth DIR --answers DIR --out FILE

`--answers` holds a folder per case with `diagnosis.json`. Further sets of answers to the same
cases are given by `--baseline NAME=DIR`, those of a library without the true effect by
`--without DIR`, what became of recommended experiments by `--experiments DIR`. Writes FILE (JSON)
and beside it FILE.md.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.physics.places import Ring
from tests.blind.figures import Figure, calibration, confusion, figures, left_out
from tests.blind.judging import Judged, Order, judge
from tests.blind.resolving import Tried, experiments_table, read_tried, resolving
from tests.blind.truth import read_truth


def _all(truths: Sequence[dict[str, Any]], folder: Path, orders: dict[str, Order]) -> list[Judged]:
    return [judge(truth, folder / truth["case"], orders) for truth in truths]


def _numbers(figure: Figure) -> dict[str, Any]:
    return {
        key: None if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in asdict(figure).items()
    }


def markdown(
    columns: dict[str, list[Figure]],
    extra: list[Figure],
    table: dict[str, Any],
    reliability: list[dict[str, Any]],
    manifest: dict[str, Any],
) -> str:
    """Write the table for people."""
    names = list(columns)
    lines = [
        f"# Blind check: suite `{manifest['suite']}`, seed {manifest['seed']}",
        "",
        f"Truth sha256 `{manifest['sha256']}`. Rates with 95 % Wilson intervals, medians with "
        "90 % bootstrap intervals; in brackets the number of cases, fewer where a method takes "
        "long. Cases without an answer count as wrong.",
        "",
        f"| figure | at least | {' | '.join(names)} |",
        f"|---|---|{'---|' * len(names)}",
    ]
    for rows in zip(*columns.values(), strict=True):
        cells = " | ".join(_cell(row) for row in rows)
        lines.append(f"| {rows[0].name} | {rows[0].wanted} | {cells} |")
    for row in extra:
        lines.append(f"| {row.name} | {row.wanted} | {_cell(row)} |{' |' * (len(names) - 1)}")
    lines += ["", "## Reliability", "", "| told | right | cases |", "|---|---|---|"]
    lines += [f"| {r['told']:.2f} | {r['right']:.2f} | {r['count']} |" for r in reliability]
    lines += ["", "## What was called what (d' ≥ 6)", "", "| true | called |", "|---|---|"]
    for kind, called in table.items():
        words = ", ".join(f"{name} {count}" for name, count in called.most_common())
        lines.append(f"| {kind} | {words} |")
    return "\n".join(lines) + "\n"


def _cell(figure: Figure) -> str:
    if not np.isfinite(figure.value):
        return "–"
    if not np.isfinite(figure.low):
        return f"{figure.value:.3f} ({figure.count})"
    return f"{figure.value:.3f} [{figure.low:.3f}, {figure.high:.3f}] ({figure.count})"


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="Score answers against the truth.")
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--answers", type=Path, required=True)
    parser.add_argument("--without", type=Path, help="answers of a library without the effect")
    parser.add_argument("--experiments", type=Path, help="plans/, truth/ and answers/ of those")
    parser.add_argument("--baseline", action="append", default=[], help="NAME=DIR, repeatable")
    parser.add_argument("--rings", type=Path, help="folder with second-ring.csv and .json")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    truths, manifest = read_truth(options.truth)
    orders = {"first": Order(Ring.load())}
    rings = options.rings or options.truth.parent
    if any(truth["ring"] == "second" for truth in truths):
        second = Ring.load(rings / "second-ring.csv", rings / "second-ring.json")
        orders["second"] = Order(second)
    judged = _all(truths, options.answers, orders)
    columns = {"orbitfb": figures(judged)}
    for text in options.baseline:
        name, _, folder = text.partition("=")
        mine = [truth for truth in truths if (Path(folder) / truth["case"]).is_dir()]
        columns[name] = figures(_all(mine, Path(folder), orders))
    missed: list[Figure] = []
    extra: list[Figure] = []
    if options.without is not None:
        asked = [t for t in truths if (options.without / t["case"]).is_dir()]
        missed = left_out(_all(asked, options.without, orders))
    tried: list[Tried] = []
    if options.experiments is not None:
        tried = read_tried(options.experiments, truths, orders)
        extra += resolving(tried)
    _, reliability = calibration(judged)
    table = confusion(judged)
    document = {
        "suite": manifest["suite"],
        "seed": manifest["seed"],
        "truth_sha256": manifest["sha256"],
        "figures": {name: [_numbers(f) for f in rows] for name, rows in columns.items()},
        "left_out": [_numbers(f) for f in missed],
        "resolving": [_numbers(f) for f in extra],
        "experiments": [one.line() for one in tried],
        "reliability": reliability,
        "confusion": {kind: dict(called) for kind, called in table.items()},
        "cases": [_line(one) for one in judged],
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(document, indent=1), encoding="utf-8")
    text = markdown(columns, [*missed, *extra], table, reliability, manifest) + experiments_table(
        tried
    )
    options.out.with_suffix(".md").write_text(text, encoding="utf-8")
    print(text)


def _line(one: Judged) -> dict[str, Any]:
    values = {
        "case": one.case,
        "true": one.kind,
        "d_prime": round(one.d_prime, 2),
        "dither": one.truth["dither"],
        "planes": one.truth["planes"],
        "ring": one.truth["ring"],
        "state": one.state,
        "named": one.effects,
        "probability": one.probability,
        "right": one.right,
        "place": one.place,
        "covered": one.covered,
        "recovered": one.recovered,
        "fitted": one.fitted,
        "shrink_um": one.shrink_um,
    }
    return {
        k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()
    }


if __name__ == "__main__":
    main()
