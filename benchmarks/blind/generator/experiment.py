"""Do the experiments that were asked for: the same machine once more, with the planned excitation.

    python -m benchmarks.blind.generator.experiment --truth DIR --plans DIR --out DIR --sealed DIR

A process of its own. It alone knows the truth, and of a plan it knows the file that the loop would
be given: PLANS/CASE.npz. Ring, loop, noise level, small errors and effects are those of the case,
what is random is drawn anew; the golden orbit stands still. The record begins when the loop has
closed and ends when the excitation has.
"""

import argparse
import hashlib
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.generator.cases import Chosen, Spec, arrays, choose, figures
from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.drawing import wander
from benchmarks.blind.generator.generate import save, seal
from benchmarks.blind.generator.machine import run
from benchmarks.blind.generator.rings import Array
from benchmarks.blind.generator.sealed import read_truth

AFTER = 10
"""Ticks of the record after the excitation."""
_NEW = 2**31
"""Beyond the seeds of cases."""


def read_excitation(file: Path, case: Conditions) -> tuple[Array, int]:
    """Read where the setpoints are to stand around those of the feedback.

    Returns:
        Excursions of all correctors, (T, m) [A], and the tick after the loop has closed in which
        they begin.
    """
    with np.load(file, allow_pickle=False) as given:
        rows, names = given["waveform"], [str(name) for name in given["corr_names"]]
        planes = [str(plane) for plane in given["planes"]]
        start = float(given["start_s"])
    own: list[str] = [plane for plane in case.all_planes for _ in case.correctors]
    column = {device: at for at, device in enumerate(zip(case.corr_names, own, strict=True))}
    whole = np.zeros((len(rows), len(own)))
    whole[:, [column[device] for device in zip(names, planes, strict=True)]] = rows
    return whole, round(start / case.period)


def set_up(case: Conditions, excursion: Array, wait: int, now: int, rng: Any) -> int:
    """Make circumstances those of an experiment, in place, because effects hold on to them.

    Args:
        case: Of the record that asked for it.
        excursion: (T, m) [A].
        wait: Ticks in the record before it.
        now: Row of the case from which the machine goes on.
        rng: Of what is new.

    Returns:
        Ticks of the excursion for which the case has room.
    """
    room = min(len(excursion), case.ticks - wait - AFTER)
    case.reference = np.tile(case.reference[now], (case.rows, 1))
    case.dither = case.dither[rng.integers(0, case.rows, case.rows)]  # its rows are independent
    begin = case.warm + wait
    case.dither[begin : begin + room] += excursion[:room]
    for plane in case.all_planes:
        moved, case.ground_laws[plane] = wander(case, plane, 1.0, rng)
        case.quad_kicks[plane] = moved - moved[0] + case.quad_kicks[plane][now]
    return room


def same(chosen: list[Chosen], effects: list[dict[str, Any]]) -> bool:
    """Tell whether what was drawn again is what the truth tells."""
    if len(chosen) != len(effects):
        return False
    for (_, maker, draft, size, _), told in zip(chosen, effects, strict=True):
        drawn = figures(draft.figures(size))
        if (maker.id, draft.places, set(drawn)) != (
            told["effect"],
            told["places"],
            set(told["parameters"]),
        ):
            return False
        for name, value in drawn.items():
            if not np.isclose(value["value"], told["parameters"][name]["value"], rtol=1e-6, atol=0):
                return False
    return True


def do(out: Path, sealed: Path, suite_seed: int, file: Path, truth: dict[str, Any]) -> str:
    """Do one experiment and write its record and truth; leave those that are there already.

    Returns:
        Why not; empty: it was done.
    """
    name = truth["case"]
    record, told = out / f"{name}.npz", sealed / f"{name}.json"
    if record.exists() and told.exists():
        return ""
    wanted: dict[str, Any] = {**truth["spec"], "effects": tuple(truth["spec"]["effects"])}
    spec = Spec(**wanted)
    case, chosen, _ = choose(spec, out, suite_seed)
    if not same(chosen, truth["effects"]):
        return f"{name}: the generator has changed since; this case cannot be drawn again"
    excursion, wait = read_excitation(file, case)
    room = set_up(
        case, excursion, wait, case.warm + truth["ticks"], np.random.default_rng([spec.seed, 4])
    )
    # All that had an onset is there by now; what throws the beam out begins with the record.
    effects = [
        (case.warm if maker.unstable else 0, draft.build(size))
        for _, maker, draft, size, _ in chosen
    ]
    log = run(case, effects, _NEW + spec.seed)
    ticks = min(wait + room + AFTER, len(log.readings) - 1)
    save(record, arrays(case, log, 0, ticks))
    os.utime(record, (1.7e9, 1.7e9))
    document = {
        **truth,
        "effects": [{**effect, "onset_s": None} for effect in truth["effects"]],
        "later": False,
        "ticks": ticks,
        "planned_ticks": wait + len(excursion) + AFTER,
        "excitation_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
    }
    told.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return ""


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="Do the experiments that were asked for.")
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--plans", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="for the records")
    parser.add_argument("--sealed", type=Path, required=True, help="for the truth of the records")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    truths, manifest = read_truth(options.truth)
    asked = [truth for truth in truths if (options.plans / f"{truth['case']}.npz").exists()]
    for folder in (options.out, options.sealed):
        folder.mkdir(parents=True, exist_ok=True)
    work = partial(do, options.out, options.sealed, manifest["seed"])
    files = [options.plans / f"{truth['case']}.npz" for truth in asked]
    with ProcessPoolExecutor(options.jobs) as pool:
        for count, problem in enumerate(pool.map(work, files, asked), 1):
            print(f"\r{count} of {len(asked)} experiments", end="", file=sys.stderr, flush=True)
            if problem:
                print(f"\n{problem}", file=sys.stderr)
    if asked:
        print(file=sys.stderr)
    seal(options.out, options.sealed, manifest["suite"], manifest["seed"])


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
