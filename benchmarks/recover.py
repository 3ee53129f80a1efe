"""Simulate every effect at a size that shows, and see whether its scan and its fit get it back.

    python -m benchmarks.recover [--effect ID] [--ticks 1000] [--seeds 3] [--rivals]

The place is drawn by the seed. The scan has to name it; the fit begins away from the truth, once
from what the scan proposes and once at the true place with values half as large again. A value
counts as recovered when it is inside the 90 % interval that an answer would state.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit, fit
from orbitfb.diagnose.noise_levels import level_candidates
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.randomness import noise_candidates
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import Since, layout_of
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.registry import all_effects
from orbitfb.effects.sensors.bpm_current import CHANNEL, top_up_current
from orbitfb.physics.effect import generator
from orbitfb.physics.places import Indices, Planes, Ring
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

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
    "bpm-latency": {"ticks": 2.0},
    "bpm-lowpass": {"tau": 0.1},
    "bpm-nonlinearity": {"quadratic": 3e3, "cubic": -1e8},
    "bpm-offset": {"offset": 2e-6},
    "bpm-roll": {"angle": 0.05},
    "bpm-walk": {"step": 2e-8},
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
    "periodic-disturbance": {"cosine": 3e-8, "sine": -2e-8, "frequency": 0.737},
    "quadrupole-gradient": {"gradient": 0.005},
    "sextupole": {"strength": 60.0},
    "skew-coupling": {"skew": 0.005},
    "telegraph": {"kick": 1.5e-7, "probability": 0.02},
    "thermal-drift": {"rate": 1e-8, "tau": 20.0},
    "tune-drift": {"rate_x": 5e-5, "rate_y": 0.0},
    "tune-shift": {"dnu_x": 0.005, "dnu_y": 0.0},
}
"""Sizes that 1000 ticks show clearly; the limit of a saturation is taken from a quiet record."""


@dataclass(frozen=True, slots=True)
class Case:
    """An effect in a record.

    Args:
        truth: What was simulated; places as the engine counts them.
        planes: Of the record.
        seed: Of place, plant and effect.
    """

    truth: Cause
    planes: Planes
    seed: int


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of a case: whether the scan's best has the true places (and beginning), the gain
    of the fit [nats], its values with the ends of their 90 % intervals, and the best other kind
    with the evidence by which the true one is ahead [nats], if that was asked for."""

    found: bool
    gain: float
    values: Values
    low: Values
    high: Values
    proposed: Candidate | None
    rival: tuple[str, float] | None = None


def draw(kind: EffectKind, seed: int, ticks: int, later: bool) -> Case:
    """Draw a place; take the size from the table."""
    planes = PLANES.get(kind.id, "x")
    layout = layout_of(Ring.load(), planes, 0.1)
    rng = generator(seed, f"recover {kind.id}")
    places: tuple[int, ...] = ()
    if kind.target != "ring":
        places = (int(rng.integers(_count(kind, layout))),)
    if isinstance(kind, NoiseKind) and kind.id == "noise-correlated":
        places = (int(rng.integers(len(kind.places_of(layout)) - 1)),)
    values = SIZES.get(kind.id, {})
    if kind.id == "corrector-saturation":
        # the one that leaves the range of its beginning by most: from then on it is clipped
        quiet = simulate_record(Ring.load(), planes, ticks, seed, dither=DITHER)
        size, early = np.abs(quiet.setpoints), ticks * 2 // 5
        reached = size[:early].max(axis=0)
        best = int(np.argmax(size[early:].max(axis=0) - reached))
        corner = 0.05 * float(np.ptp(quiet.setpoints[:, best]))
        places = (best,)
        values = {"limit": float(reached[best]), "side": 0.0, "rounding": corner}
    onset = ticks * 2 // 5 if later or kind.id in LATER else 0
    return Case(Cause(kind, places, values, onset), planes, seed)


def _count(kind: EffectKind, layout: Layout) -> int:
    if isinstance(kind, PairKind):
        return len(kind.pairs(layout))
    if isinstance(kind, SourceKind | NoiseKind):
        return len(kind.places_of(layout))
    return len(layout.bpms if kind.target == "bpm" else layout.correctors)


def columns_of(kind: EffectKind, places: tuple[int, ...], layout: Layout) -> Indices:
    """Tell places as the simulation counts them."""
    if isinstance(kind, PairKind):
        return np.array(kind.struck(layout, places[0]), dtype=np.intp)
    if isinstance(kind, NoiseKind) and kind.target == "bpm":
        return np.flatnonzero(kind.patterns(layout)[:, places[0]])
    return np.array(places, dtype=np.intp)


def record_of(case: Case, ticks: int) -> Record:
    """Simulate a case."""
    ring = Ring.load()
    layout = layout_of(ring, case.planes, 0.1)
    truth, kind = case.truth, case.truth.kind
    rng = generator(case.seed, f"effect {kind.id}")
    effect = kind.simulate(layout, columns_of(kind, truth.places, layout), truth.values, rng)
    begin = SETTLE + truth.onset if truth.onset or kind.grows else 0
    if kind.id == "periodic-disturbance":
        begin = SETTLE  # its phase is counted from the first row
    own_clock = kind.grows or kind.id == "periodic-disturbance"
    record = simulate_record(
        ring,
        case.planes,
        ticks,
        case.seed,
        [Since(effect, begin, own_clock) if begin else effect],
        dither=DITHER,
        settle=SETTLE,
    )
    if kind.id != "bpm-current":
        return record
    current = top_up_current(record.time + SETTLE * layout.period)
    return replace(record, auxiliary={CHANNEL: current})


def propose(bench: Bench, kind: EffectKind) -> list[Candidate]:
    if isinstance(kind, NoiseKind):
        found = [*noise_candidates(bench, kind), *level_candidates(bench, [kind])]
        return sorted(found, key=lambda c: c.gain - np.log(c.choices), reverse=True)
    if isinstance(kind, LatentKind):
        return latent_candidates(bench, kind)
    return Scanner(bench).candidates(kind)


def refine(bench: Bench, cause: Cause) -> Fit:
    """Fit a cause, and again under the floor that it leaves, as a search does."""
    first = fit(bench, (cause,))
    return fit(bench.with_floor(bench.floor_without(first.causes)), first.causes, precise=True)


def away(cause: Cause) -> Cause:
    """Move values away from the truth."""
    wrong = {
        p.name: float(np.clip(1.5 * cause.values[p.name], p.low, p.high))
        for p in cause.kind.parameters
    }
    if cause.kind.id == "periodic-disturbance":
        wrong["frequency"] = cause.values["frequency"]
    return replace(cause, values=wrong)


def recover(
    case: Case, ticks: int, background: float = 0.0, rivals: bool = False
) -> Iterator[Recovered]:
    """Recover a case: from the scan, then from values that are half as large again."""
    record = record_of(case, ticks)
    bench = Bench(record, background=background)
    kind, truth = case.truth.kind, case.truth
    proposals = propose(bench, kind)
    best = proposals[0] if proposals else None
    near = best is not None and (not truth.onset or abs(best.cause.onset - truth.onset) <= 20)
    found = (
        near and best is not None and (kind.target == "ring" or best.cause.places == truth.places)
    )
    if isinstance(kind, NoiseKind | LatentKind):
        if best is None:
            yield Recovered(False, 0.0, {}, {}, {}, None)
            return
        stated = state(bench, best.cause)
        low, high = ({name: ends[end] for name, ends in stated.intervals.items()} for end in (0, 1))
        yield Recovered(found, best.gain, stated.cause.values, low, high, best)
        return
    rival = None
    if rivals:
        known = [k for k in all_effects().values() if not k.unavailable(record)]
        entries = tournament(bench, known)
        own = max((e.weight for e in entries if e.kind.id == kind.id), default=-np.inf)
        other = next((e for e in entries if e.kind.id != kind.id), None)
        rival = ("none", own) if other is None else (other.kind.id, own - other.weight)
    starts = [away(truth)] if best is None else [best.cause, away(truth)]
    for start in starts:
        done = refine(bench, start)
        names = [p.name for _, p in done.parameters]
        ends = [done.interval(index) for index in range(len(names))]
        low, high = ({n: its[end] for n, its in zip(names, ends, strict=True)} for end in (0, 1))
        yield Recovered(found, done.gain, done.causes[0].values, low, high, best, rival)


def tell(case: Case, result: Recovered) -> str:
    truth = case.truth
    words = [
        f"{truth.kind.id:22} seed {case.seed} onset {truth.onset:4}",
        "found " if result.found else "MISSED",
        f"{result.gain:9.1f} nats",
    ]
    for name, value in result.values.items():
        true, low, high = truth.values[name], result.low[name], result.high[name]
        inside = "" if low <= true <= high else " OUTSIDE"
        words.append(f"{name} {true:.4g}: {value:.6g} [{low:.6g}, {high:.6g}]{inside}")
    if result.rival is not None:
        words.append(f"{result.rival[1]:.1f} nats ahead of {result.rival[0]}")
    if not result.found and result.proposed is not None:
        cause = result.proposed.cause
        words.append(f"(scan: {cause.places[:4]} from {cause.onset}, truth {truth.places})")
    return "  ".join(words)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effect", help="id of one effect; all by default")
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--background", type=float, default=0.0, help="scale of healthy errors")
    parser.add_argument("--later", action="store_true", help="begin in the record")
    parser.add_argument("--rivals", action="store_true", help="let all kinds compete (slow)")
    options = parser.parse_args()
    known = all_effects()
    for kind in [known[options.effect]] if options.effect else known.values():
        if kind.id == "bpm-stuck":
            continue  # left to the integrity screen
        if options.later and not kind.sudden:
            continue
        for seed in range(options.seeds):
            case = draw(kind, seed, options.ticks, options.later)
            for result in recover(case, options.ticks, options.background, options.rivals):
                print(tell(case, result), flush=True)


if __name__ == "__main__":
    main()
