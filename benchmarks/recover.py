"""Simulate every effect at a size that shows, and see whether the tournament finds it.

    python -m benchmarks.recover [--effect ID] [--ticks 1000] [--seeds 1] [--default-ring]

The place is drawn by the seed. The best of all effects together has to be the one that was
simulated, at its place; its values are printed beside the true ones.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.simulate import simulate_record
from benchmarks.small_ring import small_ring
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import Since, layout_of
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.registry import all_effects
from orbitfb.effects.sensors.bpm_current import CHANNEL, top_up_current
from orbitfb.estimation.priors import SURE
from orbitfb.physics.effect import generator
from orbitfb.physics.places import Indices, Planes, Ring
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

SCREENED = ("bpm-stuck", "missed-read")
"""Exact repeats are found by the integrity screen, not by a likelihood."""
OPEN = ("bpm-polarity", "bpm-swap", "corrector-polarity", "corrector-swap")
"""Effects with which a closed loop runs away before there is a record: the loop stays open."""

SETTLE = 200
PERIOD = 0.1
DITHER = 3e-4
"""White dither that tells actuators from sensors, rms [A]."""
PLANES: dict[str, Planes] = {"bpm-roll": "xy", "corrector-roll": "xy", "skew-coupling": "xy"}
"""Effects that one plane cannot show."""
LATER = (
    "bpm-offset",
    "corrector-slew",
    "corrector-stuck",
    "energy-offset",
    "local-kick",
    "ground-motion-level",
    "insertion-device",
)
"""Effects that nobody sees when they have always been there, or that wind up before the record."""
SIZES: dict[str, Values] = {
    "bpm-current": {"slope": 3e-4},
    "bpm-drift": {"rate": 0.05e-6},
    "bpm-gain": {"gain": 0.1},
    "bpm-hum": {"cosine": 3e-7, "sine": -2e-7, "frequency": 0.737},
    "bpm-row": {"share": 0.3},
    "corrector-column": {"share": 0.3},
    "bpm-latency": {"ticks": 2.0},
    "bpm-lowpass": {"tau": 0.1},
    "bpm-nonlinearity": {"quadratic": 3e3, "cubic": -1e8},
    "bpm-offset": {"offset": 2e-6},
    "bpm-roll": {"angle": 0.05},
    "bpm-walk": {"step": 6e-8},
    "clock-jitter": {"rms": 0.05},
    "corrector-crosstalk": {"share": 0.3},
    "corrector-deadband": {"width": 1e-3},
    "corrector-gain": {"gain": 0.15},
    "corrector-hysteresis": {"width": 1e-3, "share": 0.7},
    "corrector-lag": {"tau": 0.1, "second": 0.03},
    "corrector-quantisation": {"step": 1.5e-3},
    "corrector-resonance": {"frequency": 2.0, "damping": 0.2},
    "corrector-roll": {"angle": 0.2},
    "corrector-slew": {"rate": 3e-3},
    "corrector-stuck": {"left": 0.3, "decay": 0.2},
    "energy-ramp": {"rate": 5e-7},
    "energy-offset": {"offset": 1e-5},
    "energy-drift": {"step": 3e-7},
    "ground-motion-level": {"factor": 2.0},
    "insertion-device": {"kick": 5e-7, "period": 0.03, "duration": 5.0},
    "local-kick": {"kick": 3e-7},
    "loop-delay": {"ticks": 0.4},
    "missed-read": {"probability": 0.02},
    "missed-write": {"probability": 0.02},
    "noise-coloured": {"correlation": 0.6},
    "noise-correlated": {"rms": 0.2e-6},
    "noise-level": {"factor": 2.0},
    "noise-tails": {"probability": 0.01, "amplitude": 3e-6},
    "optics-drift": {"rate": 3e-4},
    "orbit-lengthening": {"share": 18.0},
    "periodic-disturbance": {"cosine": 3e-8, "sine": -2e-8, "frequency": 0.737},
    "quadrupole-gradient": {"gradient": 0.005},
    "sextupole": {"strength": 60.0},
    "skew-coupling": {"skew": 0.005},
    "telegraph": {"kick": 1.5e-7, "probability": 0.02},
    "thermal-drift": {"rate": 1e-8, "tau": 20.0},
    "tune-drift": {"rate_x": 5e-5, "rate_y": 0.0},
    "tune-shift": {"dnu_x": 0.005, "dnu_y": 0.0},
}
"""Sizes that 1000 ticks show clearly, but that of `orbit-lengthening`, which takes larger orbits;
the limit of a saturation is taken from a quiet record."""


@dataclass(frozen=True, slots=True)
class Case:
    """An effect in a record.

    Args:
        ring: That has it.
        kind: The effect.
        places: As the engine counts them; empty: the ring.
        values: Of its parameters.
        onset: Row at which it begins.
        planes: Of the record.
        seed: Of place, plant and effect.
    """

    ring: Ring
    kind: EffectKind
    places: tuple[int, ...]
    values: Values
    onset: int
    planes: Planes
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Recovered:
    """What became of a case.

    Args:
        accepted: Causes in the order in which they were accepted.
        own: The best candidate of the true effect in the first round; None: there is none.
        unknown: Whether an unknown law of a device explained more than any effect.
    """

    accepted: tuple[Candidate, ...]
    own: Candidate | None
    unknown: bool

    def places(self, case: Case) -> bool:
        """Whether the first cause is at the devices that were struck."""
        struck = columns_of(case.kind, case.places, layout_of(case.ring, case.planes, PERIOD))
        return bool(self.accepted) and set(self.accepted[0].places) == set(map(int, struck))

    @property
    def first(self) -> str:
        """Id of the first cause; empty: there is none."""
        return self.accepted[0].kind.id if self.accepted else ""

    @property
    def alike(self) -> tuple[str, ...]:
        """Ids that mean the same fault as the first cause."""
        return (self.first, *self.accepted[0].kind.also_called) if self.accepted else ()


def draw(kind: EffectKind, seed: int, ticks: int, ring: Ring) -> Case:
    """Draw a place; take the size from the table. What strikes rows strikes all devices."""
    planes = PLANES.get(kind.id, "x")
    layout = layout_of(ring, planes, PERIOD)
    rng = generator(seed, f"recover {kind.id}")
    places: tuple[int, ...] = ()
    if kind.target != "ring" and (not isinstance(kind, LatentKind) or kind.per_bpm):
        places = (int(rng.integers(_count(kind, layout))),)
    if isinstance(kind, NoiseKind) and kind.id == "noise-correlated":
        places = (int(rng.integers(len(kind.places_of(layout)) - 1)),)
    values = SIZES.get(kind.id, {})
    if kind.id == "corrector-saturation":
        # the one that leaves the range of its beginning by most: from then on it is clipped
        quiet = simulate_record(ring, planes, ticks, seed, dither=DITHER)
        size, early = np.abs(quiet.setpoints), ticks * 2 // 5
        reached = size[:early].max(axis=0)
        best = int(np.argmax(size[early:].max(axis=0) - reached))
        places = (best,)
        values = {"limit": float(reached[best]), "side": 0.0}
    onset = ticks * 2 // 5 if kind.id in LATER else 0
    return Case(ring, kind, places, values, onset, planes, seed)


def _count(kind: EffectKind, layout: Layout) -> int:
    if isinstance(kind, PairKind):
        return len(kind.pairs(layout))
    if isinstance(kind, SourceKind | NoiseKind):
        return len(kind.places_of(layout))
    return len(layout.bpms if kind.target == "bpm" else layout.correctors)


def columns_of(kind: EffectKind, places: tuple[int, ...], layout: Layout) -> Indices:
    """Tell places as the simulation counts them."""
    if isinstance(kind, PairKind):
        return np.array(kind.struck(kind.pairs(layout))[places[0]], dtype=np.intp)
    if isinstance(kind, NoiseKind) and kind.target == "bpm":
        return np.flatnonzero(kind.patterns(layout)[:, places[0]])
    return np.array(places, dtype=np.intp)


def record_of(case: Case, ticks: int) -> Record:
    """Simulate a case."""
    layout, kind = layout_of(case.ring, case.planes, PERIOD), case.kind
    rng = generator(case.seed, f"effect {kind.id}")
    effect = kind.simulate(layout, columns_of(kind, case.places, layout), case.values, rng)
    begin = SETTLE + case.onset if case.onset or kind.grows else 0
    waves = kind.id in ("periodic-disturbance", "bpm-hum")
    if waves:
        begin = SETTLE  # their phase is counted from the first row
    own_clock = kind.grows or waves
    record = simulate_record(
        case.ring,
        case.planes,
        ticks,
        case.seed,
        [Since(effect, begin, own_clock) if begin else effect],
        dither=DITHER,
        settle=SETTLE,
        gain=1e-6 if kind.id in OPEN else 0.35,
    )
    if kind.id != "bpm-current":
        return record
    current = top_up_current(record.time + SETTLE * layout.period)
    return replace(record, auxiliary={CHANNEL: current})


def recover(case: Case, ticks: int) -> Recovered:
    """Let all effects compete for a case."""
    record = record_of(case, ticks)
    kinds = [
        kind
        for kind in all_effects().values()
        if not kind.unavailable(record) and kind.id not in SCREENED
    ]
    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)
    first = rounds[0]
    own = next((one for one in first.candidates if one.kind.id == case.kind.id), None)
    return Recovered(tuple(accepted), own, not accepted and bool(_telling(first.free)))


def _telling(free: tuple[FreeCourse, ...]) -> list[FreeCourse]:
    return [one for one in free if one.evidence > SURE]


def tell(case: Case, result: Recovered) -> str:
    """Write what became of a case in a line, and in a line each what was accepted."""
    values = " ".join(f"{name}={value:.4g}" for name, value in case.values.items())
    if result.first == case.kind.id:
        verdict = "found" if result.places(case) else "found, other place"
    else:
        verdict = "UNKNOWN" if result.unknown else "MISSED"
    lines = [f"{case.kind.id:22} {verdict:18} place {case.places} row {case.onset} {values}"]
    lines += [f"    accepted {one.describe()}" for one in result.accepted]
    if result.first != case.kind.id and result.own is not None:
        lines.append(f"    own      {result.own.describe()}")
    return "\n".join(lines)


def cases(ids: list[str], ticks: int, seeds: int, ring: Ring) -> Iterator[Case]:
    """Draw every effect that a likelihood can find, with every seed."""
    known = all_effects()
    for name in ids or [one for one in known if one not in SCREENED]:
        for seed in range(1, seeds + 1):
            yield draw(known[name], seed, ticks, ring)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effect", help="id of one effect; all by default")
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--default-ring", action="store_true", help="180 BPMs instead of 45")
    options = parser.parse_args()
    ring = Ring.load() if options.default_ring else small_ring()
    ids = [options.effect] if options.effect else []
    for case in cases(ids, options.ticks, options.seeds, ring):
        print(tell(case, recover(case, options.ticks)), flush=True)


if __name__ == "__main__":
    main()
