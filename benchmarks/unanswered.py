"""Data that do not answer, at the loop in process: what the true orbit does until it is noticed.

`python -m benchmarks.unanswered --seeds 401-410` breaks BPMs and power supplies of the simulated
ring in eight ways, ten times each, and tells the largest true orbit error until the end; without
faults (`--healthy TICKS`) it counts false alarms.
"""

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.circumstances import circumstances
from orbitfb.core.signals import LoopState
from orbitfb.physics.places import Ring
from tests.unit.loop.lying import closed_loop

BEFORE = 100
"""Orbits before the fault [1]: the loop has closed and asked its first questions."""


@dataclass(frozen=True, slots=True)
class Fault:
    """What lies, from when on, for how long.

    Args:
        name: For the table.
        ticks: That are looked at after its beginning.
        blind: First and last BPM that shows a pattern and noise in place of the beam.
        deaf: First and last corrector whose readback echoes while its field stays.
        pattern: Rms of what blind BPMs show [m].
    """

    name: str
    ticks: int
    blind: tuple[int, int] | None = None
    deaf: tuple[int, int] | None = None
    pattern: float = 1e-6


FAULTS = (
    Fault("all BPMs blind, 10 µm", 200, blind=(0, 180), pattern=10e-6),
    Fault("all BPMs blind, 3 µm", 150, blind=(0, 180), pattern=3e-6),
    Fault("all supplies deaf", 300, deaf=(0, 180)),
    Fault("a cell of BPMs blind", 600, blind=(60, 66)),
    Fault("a cell of BPMs blind, 10 µm off", 400, blind=(60, 66), pattern=10e-6),
    Fault("a cell of supplies deaf", 1500, deaf=(78, 84)),
    Fault("one BPM blind", 700, blind=(17, 18)),
    Fault("one supply deaf", 700, deaf=(33, 34)),
)


@dataclass(frozen=True, slots=True)
class Run:
    """How one loop ended.

    Args:
        fault: Its name; empty: none.
        seed: Of the plant and the lies.
        state: Of the loop at the end.
        noticed: Ticks after the fault at which it stopped or left devices out; None: never.
        worst_um: Largest true orbit error after the fault, rms over the BPMs [µm].
        reasons: What the loop said.
    """

    fault: str
    seed: int
    state: str
    noticed: int | None
    worst_um: float
    reasons: tuple[str, ...]


def run(ring: Ring, seed: int, fault: Fault | None, ticks: int) -> Run:
    """Run a loop, with a fault after a while or without."""
    lying: Any
    lying, runner, _, records = closed_loop(ring, seed)
    lying._random = np.random.default_rng(seed + 1000)
    noticed, worst = None, 0.0
    reasons: dict[str, None] = {}
    for tick in range(BEFORE + ticks):
        if fault is not None and tick == BEFORE:
            _break(lying, fault)
        runner.step()
        del records[:-5]
        after = tick - BEFORE
        if after < 0:
            continue
        worst = max(worst, float(lying.machine.true_orbit_rms))
        if runner.reason:
            reasons.setdefault(runner.reason[:120], None)
        named = any(words in runner.reason for words in ("not answer", "not follow"))
        spoke = runner.state is not LoopState.CLOSED or named
        if noticed is None and spoke:
            noticed = after
        if runner.state is LoopState.TRIPPED:
            break
    name = "" if fault is None else fault.name
    return Run(name, seed, str(runner.state), noticed, 1e6 * worst, tuple(reasons)[:4])


def _break(lying: Any, fault: Fault) -> None:
    lying.pattern = fault.pattern
    if fault.blind is not None:
        lying.blind[slice(*fault.blind)] = True
    if fault.deaf is not None:
        lying.deaf[slice(*fault.deaf)] = True


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1-3", help="first and last seed")
    parser.add_argument("--healthy", type=int, metavar="TICKS", help="no fault, so many ticks each")
    parser.add_argument("--out", type=Path, help="JSON of all runs")
    options = parser.parse_args()
    ring, seeds = Ring.load(), _seeds(options.seeds)
    runs: list[Run] = []
    for fault in (None,) if options.healthy else FAULTS:
        mine = [
            run(ring, seed, fault, options.healthy if fault is None else fault.ticks)
            for seed in seeds
        ]
        runs += mine
        told = [one.noticed for one in mine if one.noticed is not None]
        late = f"noticed after {np.median(told):.0f} ticks (median)" if told else "never noticed"
        worst = [one.worst_um for one in mine]
        print(
            f"{fault.name if fault else 'no fault'}: {len(told)} of {len(mine)} {late}, true orbit "
            f"{np.median(worst):.2f} µm rms (median), {max(worst):.2f} µm (largest)",
            flush=True,
        )
    if options.out is not None:
        about = circumstances("python -m benchmarks.unanswered", len(seeds), quick=False)
        content = {**about, "seeds": seeds, "runs": [asdict(one) for one in runs]}
        options.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
