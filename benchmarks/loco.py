"""Diagnosis of synthetic measured responses with truth: `python -m benchmarks.loco --seeds 1-200`.

Every seed draws a ring (default or 60 × 48), healthy errors (gains 1-4 %, gradients that beat by
some per cent), noise of 1-3 µm at 100 µrad, and for every other seed one fault of 5 to 15 healthy
spreads, a reversed, dead or exchanged device, or a quadrupole that is 5 % off. One JSON is printed.
With `--rows FILE` every seed is kept there as it is done, and not done again.
"""

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.loco.measured import Measured, Pair, bpm_labels, corrector_labels
from orbitfb.loco.optics import RingOptics
from orbitfb.loco.run import Result, diagnose
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane, Ring
from orbitfb.physics.response import seeded_gradient_errors

_PLANES: tuple[Plane, Plane] = ("x", "y")
_KICK = 100e-6
_NINETY = 1.6448536
"""Half width of a 90 % interval, in standard deviations."""


@dataclass
class Case:
    """A response with its truth."""

    ring: Ring
    measured: Measured
    gain: dict[Plane, np.ndarray]
    kick: dict[Plane, np.ndarray]
    relative: np.ndarray
    kind: str = "none"
    places: tuple[str, ...] = ()


@dataclass
class Score:
    """What is counted, of one seed or of many."""

    right: list[bool] = field(default_factory=list)
    healthy: list[bool] = field(default_factory=list)
    inside: Counter = field(default_factory=Counter)
    total: Counter = field(default_factory=Counter)
    seconds: dict[str, list[float]] = field(default_factory=dict)
    misses: list[str] = field(default_factory=list)


def devices(ring: Ring, size: str) -> Measured:
    """A measurement without numbers: all of the default ring, or 60 BPMs and 48 correctors."""
    bpms, correctors = ring.places("BPM"), ring.places("COR")
    if size == "60x48":
        bpms = bpms[::3]
        correctors = correctors[np.linspace(0, len(correctors) - 1, 48).astype(int)]
    absent = np.full((len(bpms), len(correctors)), np.nan)
    nothing: dict[Pair, Matrix] = {(p, p): absent for p in _PLANES}
    return Measured(
        dict.fromkeys(_PLANES, bpms), dict.fromkeys(_PLANES, correctors), dict(nothing), nothing
    )


def draw(seed: int, size: str) -> Case:
    """Draw a response."""
    rng, ring = np.random.default_rng(seed), Ring.load()
    empty = devices(ring, size)
    optics = RingOptics(ring, empty)
    scatter = rng.uniform(0.01, 0.04)
    beat = rng.uniform(0.01, 0.05)
    gradients = seeded_gradient_errors(ring, beat, int(rng.integers(2**31)))
    case = Case(
        ring, empty,
        {p: 1 + scatter * rng.standard_normal(len(empty.bpms[p])) for p in _PLANES},
        {p: 1 + scatter * rng.standard_normal(len(empty.correctors[p])) for p in _PLANES},
        gradients / optics.strength,
    )  # fmt: skip
    swap: tuple[Plane, int, tuple[int, int]] | None = None
    if seed % 2:
        swap = _fault(case, rng, scatter)
    its, noise = optics.at(case.relative), rng.uniform(1e-6, 3e-6) / _KICK
    response: dict[tuple[Plane, Plane], Matrix] = {}
    for p in _PLANES:
        data = case.gain[p][:, None] * its[p].own * case.kick[p]
        response[p, p] = data + noise * rng.standard_normal(data.shape)
    if swap is not None:
        plane, axis, (a, b) = swap
        data = response[plane, plane] if axis == 0 else response[plane, plane].T
        data[[a, b]] = data[[b, a]]
    sigma = {pair: np.full_like(data, noise) for pair, data in response.items()}
    case.measured = Measured(empty.bpms, empty.correctors, response, sigma)
    return case


def _fault(
    case: Case, rng: np.random.Generator, scatter: float
) -> tuple[Plane, int, tuple[int, int]] | None:
    kinds = ("gain", "polarity", "dead", "swap", "gradient")
    kind, plane = str(rng.choice(kinds)), _PLANES[int(rng.integers(2))]
    axis = int(rng.integers(2))
    what = ("bpm", "corrector")[axis]
    labels = (bpm_labels, corrector_labels)[axis](case.measured, case.ring, plane)
    values = (case.gain, case.kick)[axis][plane]
    device = int(rng.integers(len(values)))
    if kind == "gradient":
        quadrupole = int(rng.integers(len(case.relative)))
        case.relative[quadrupole] += 0.05 * rng.choice((-1, 1))
        case.kind, case.places = "quadrupole-gradient", (case.ring.names("QUAD")[quadrupole],)
        return None
    case.kind, case.places = f"{what}-{kind}", (labels[device],)
    if kind == "gain":
        values[device] = 1 + scatter * rng.uniform(6, 15) * rng.choice((-1, 1))
    elif kind == "polarity":
        values[device] *= -1
    elif kind == "dead":
        values[device] *= 0.001
    else:
        other = int((device + rng.integers(3, len(values) - 3)) % len(values))
        case.places = (labels[min(device, other)], labels[max(device, other)])
        return plane, axis, (device, other)
    return None


def score(case: Case, found: Result, counts: Score, seed: int) -> None:
    """Compare with the truth."""
    named = [its for its in found.named if its.stands_out]
    if case.kind == "none":
        counts.healthy.append(not named)
        if named:
            told = [(its.kind, its.places, its.z) for its in named]
            counts.misses.append(f"{seed}: healthy, but {told}")
    else:
        first = named[0] if named else None
        places = set() if first is None else {*first.places, *(n for n, _ in first.alternatives)}
        right = first is not None and first.kind == case.kind and set(case.places) <= places
        counts.right.append(right)
        if not right:
            told = None if first is None else (first.kind, first.places)
            counts.misses.append(f"{seed}: {case.kind} {case.places}, told {told}")
        if case.kind.endswith(("dead", "swap")):
            return  # the truth of such a row is no gain
    for p in _PLANES:
        gain, kick = found.estimates[f"gain:{p}"], found.estimates[f"calibration:{p}"]
        mean = case.gain[p][~gain.free].mean()
        _cover(counts, "gains", 1 + gain.value, gain.sigma, case.gain[p] / mean)
        _cover(counts, "calibrations", kick.value, kick.sigma, case.kick[p] * mean)
    gradient = found.estimates["gradient"]
    _cover(counts, "gradients", gradient.value, gradient.sigma, case.relative)


def _cover(
    counts: Score, name: str, value: np.ndarray, sigma: np.ndarray, truth: np.ndarray
) -> None:
    counts.inside[name] += int((np.abs(value - truth) < _NINETY * sigma).sum())
    counts.total[name] += len(value)


def wilson(hits: int, total: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if not total:
        return 0.0, 1.0
    z, share = 1.96, hits / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(share * (1 - share) / total + z * z / 4 / total**2)
    return middle - half, middle + half


def summary(counts: Score) -> dict[str, object]:
    """Make the JSON."""

    def share(hits: int, total: int) -> dict[str, object]:
        low, high = wilson(hits, total)
        return {
            "share": hits / max(total, 1),
            "of": total,
            "wilson": [round(low, 4), round(high, 4)],
        }

    return {
        "right_first": share(sum(counts.right), len(counts.right)),
        "healthy_unnamed": share(sum(counts.healthy), len(counts.healthy)),
        "covered_by_90": {n: share(counts.inside[n], counts.total[n]) for n in counts.total},
        "cpu_seconds_median": {n: float(np.median(v)) for n, v in counts.seconds.items()},
        "cpu_seconds_most": {n: max(v) for n, v in counts.seconds.items()},
        "misses": counts.misses,
    }


def one(seed: int, size: str) -> Score:
    """Draw a response, diagnose it, compare."""
    counts, case = Score(), draw(seed, size)
    begin = time.process_time()
    try:
        found = diagnose(case.ring, case.measured)
    except RingError as error:
        (counts.healthy if case.kind == "none" else counts.right).append(False)
        counts.misses.append(f"{seed}: {case.kind} {case.places}, refused: {error}")
        return counts
    counts.seconds[size] = [time.process_time() - begin]
    score(case, found, counts, seed)
    return counts


def total(rows: Iterable[Score]) -> Score:
    """Add up."""
    counts = Score()
    for its in rows:
        counts.right += its.right
        counts.healthy += its.healthy
        counts.inside += its.inside
        counts.total += its.total
        counts.misses += its.misses
        for size, seconds in its.seconds.items():
            counts.seconds.setdefault(size, []).extend(seconds)
    return counts


def _kept(file: Path | None) -> dict[str, Score]:
    if file is None or not file.exists():
        return {}
    rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    for row in rows:
        row["inside"], row["total"] = Counter(row["inside"]), Counter(row["total"])
    return {row.pop("key"): Score(**row) for row in rows}


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1-20", help="First and last seed.")
    parser.add_argument("--ring", choices=("both", "default", "60x48"), default="both")
    parser.add_argument("--rows", type=Path, help="File that keeps what is done.")
    parser.add_argument("--out", type=Path, help="File for the JSON.")
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    done, wanted = _kept(given.rows), []
    for seed in range(int(first), int(last or first) + 1):
        size = ("default", "60x48")[(seed // 2) % 2] if given.ring == "both" else given.ring
        key = f"{size} {seed}"
        wanted.append(key)
        if key not in done:
            done[key] = one(seed, size)
            if given.rows:
                with given.rows.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"key": key, **vars(done[key])}) + "\n")
    text = json.dumps(summary(total(done[key] for key in wanted)), indent=1)
    print(text)
    if given.out:
        given.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
