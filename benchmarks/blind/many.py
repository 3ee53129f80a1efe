"""Small rings of many kinds: healthy ones, and the same with an effect.

The rings are those of `fodo`. They differ as healthy rings do: in how the ground moves, how noisy
BPMs are, how readings were recorded, and which devices there are.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.faults import FAULTS, Array, Rng
from benchmarks.blind.fodo import KICK, PERIOD, WARM, Effect, label, response, save, truth_of


@dataclass(frozen=True, slots=True)
class Machine:
    """A healthy machine and how it was recorded.

    Args:
        cells: Of the ring, two lenses each.
        bpms: How many; None: one at every lens.
        correctors: The same.
        rows: Transitions of the record.
        ground: Orbit that the ground makes per tick, rms [m].
        colour: Its spectrum is f^(-colour); 2: a walk.
        damped: Share of the ground's motion that is lost at every tick [1].
        shaking: Orbit that is new at every tick, rms [m].
        sources: Lenses that shake so.
        flicker: Orbit of a spectrum 1/f besides, rms [m].
        noise: Of the readings, rms [m].
        spread: Scatter of its logarithm from BPM to BPM [1].
        gains: Scatter of the gains of BPMs and correctors [1].
        gradients: Errors of the lenses [1].
        dither: Of the requested changes, as orbit, rms [m].
        steering: Steps of the golden orbit, rms [m].
        loop: Gain of the loop [1].
        held: Share of the readings that only repeat the one before [1].
        together: Whether whole orbits repeat.
        digit: Last digit of the readings [m]; 0: none.
        step: Of the setpoints [A]; 0: none.
        invalid: Share of the readings that are missing [1].
        spikes: Readings that are far off.
        lost: Rows that were not recorded.
    """

    cells: int = 12
    bpms: int | None = None
    correctors: int | None = None
    rows: int = 900
    ground: float = 0.04e-6
    colour: float = 2.0
    damped: float = 0.0
    shaking: float = 0.0
    sources: int = 3
    flicker: float = 0.0
    noise: float = 0.2e-6
    spread: float = 0.1
    gains: float = 0.01
    gradients: float = 0.001
    dither: float = 0.0
    steering: float = 15e-6
    loop: float = 0.5
    held: float = 0.0
    together: bool = False
    digit: float = 0.0
    step: float = 0.0
    invalid: float = 0.0
    spikes: int = 0
    lost: int = 0


USUAL: dict[str, Machine] = {
    "plain": Machine(),
    "dither": Machine(dither=1.5e-6),
    "few-correctors": Machine(bpms=20, correctors=14),
    "more-bpms": Machine(cells=20, bpms=34, correctors=16),
    "unlike-bpms": Machine(spread=0.8),
    "shaking": Machine(shaking=0.3e-6),
    "one-shaking": Machine(shaking=0.3e-6, sources=1),
    "flicker": Machine(flicker=0.3e-6),
    "flat-ground": Machine(colour=1.0),
    "smooth-ground": Machine(colour=3.0),
    "damped-ground": Machine(damped=0.3),
    "held": Machine(held=0.3),
    "coarse": Machine(digit=0.2e-6),
    "invalid": Machine(invalid=0.003),
    "lost-rows": Machine(lost=30),
    "full-gain": Machine(loop=0.9),
}
"""Machines that are recorded healthy, and with every effect."""

HEALTHY: dict[str, Machine] = USUAL | {
    "dither-flat": Machine(dither=1.5e-6, colour=1.5),
    "slowly-damped": Machine(damped=0.05),
    "setpoint-steps": Machine(step=0.001),
    "spikes": Machine(spikes=3),
    "held-orbits": Machine(held=0.4, together=True),
    "quiet-bpms": Machine(noise=0.02e-6),
    "loud-bpms": Machine(noise=2e-6),
    "no-steering": Machine(steering=0.0),
    "strong-ground": Machine(ground=0.4e-6),
    "calm": Machine(steering=0.0, ground=0.004e-6),
    "large": Machine(cells=30, correctors=48),
    "long": Machine(rows=3000),
    "short": Machine(rows=300),
}
"""Machines that are recorded healthy."""


def generate(seed: int, out: Path, first: int | None, healthy: bool = False) -> list[str]:
    """Write records; the truth goes beside them.

    Args:
        seed: Of everything drawn.
        out: Folder for the records.
        first: How many, at random; None: all.
        healthy: Leave out those with a fault.

    Returns:
        Their names.
    """
    wanted = [(name, "healthy") for name in HEALTHY]
    wanted += [(name, fault) for name in USUAL for fault in FAULTS if not healthy]
    if first is not None and first < len(wanted):
        order = np.random.default_rng(seed).permutation(len(wanted))[:first]
        wanted = [wanted[place] for place in sorted(order.tolist())]
    return [write(machine, fault, seed, out) for machine, fault in wanted]


def write(name: str, fault: str, seed: int, out: Path) -> str:
    """Write the record of one machine with one fault, or healthy, and its truth; give its name."""
    machine = HEALTHY[name]
    drawn = [seed, list(HEALTHY).index(name), ["healthy", *FAULTS].index(fault)]
    rng = np.random.default_rng(drawn)
    count = 2 * machine.cells
    bpms = np.sort(rng.choice(count, machine.bpms or count, replace=False))
    correctors = np.sort(rng.choice(count, machine.correctors or count, replace=False))
    effect = Effect("missed_reads" if machine.together else "none")
    if fault in FAULTS:
        effect = FAULTS[fault](rng, len(bpms), len(correctors), machine.rows)
    log = _run(machine, effect, rng, bpms, correctors)
    keep = np.ones(machine.rows, dtype=bool)
    keep[rng.choice(machine.rows, machine.lost, replace=False)] = False
    names = label(bpms, correctors)
    healthy, local = effect.word == "none", len(effect.bpms) + len(effect.correctors) > 0
    level, shrink = ("null", None) if healthy else ("easy", 1.0)
    return save(
        f"{name}-{fault}",
        out,
        out.with_name(f"{out.name}_truth"),
        {part: values[keep] for part, values in log.items()},
        response(np.zeros(count))[np.ix_(bpms, correctors)] * KICK,
        names,
        truth_of(effect, names, local, level, shrink),
    )


def _run(
    machine: Machine, effect: Effect, rng: Rng, bpms: NDArray[np.intp], correctors: NDArray[np.intp]
) -> dict[str, Any]:
    """Run the loop, and record it in the units of the file."""
    count, rows = 2 * machine.cells, WARM + machine.rows + 1
    there = response(machine.gradients * rng.standard_normal(count))
    model = response(np.zeros(count))[np.ix_(bpms, correctors)] * KICK
    plant = there[np.ix_(bpms, correctors)] * KICK
    plant = plant * (1.0 + machine.gains * rng.standard_normal(len(correctors)))
    gains = 1.0 + machine.gains * rng.standard_normal(len(bpms))
    besides = _motion(machine, rng, there[bpms], rows)
    loud = machine.noise * np.exp(machine.spread * rng.standard_normal(len(bpms)))
    modes, size, right = np.linalg.svd(model, full_matrices=False)
    inverse = (right.T * (size / (size**2 + (0.02 * size[0]) ** 2))) @ modes.T
    golden = np.zeros((rows, len(bpms)))
    for tick in range(40, rows, 70):
        shape = modes[:, :10] @ rng.standard_normal(min(10, modes.shape[1]))
        golden[tick:] += machine.steering * shape / np.sqrt(np.mean(shape**2))
    dither = rng.standard_normal((rows, len(correctors)))
    dither *= machine.dither / np.sqrt(np.mean((dither[:200] @ model.T) ** 2))
    orbits, setpoints, now = np.zeros_like(golden), np.zeros_like(dither), np.zeros(len(correctors))
    for tick in range(rows):
        reading = gains * (plant @ effect.act(tick, now) + besides[tick])
        reading = effect.read(tick, reading + loud * rng.standard_normal(len(bpms)))
        if machine.digit:
            reading = np.round(reading / machine.digit) * machine.digit
        if tick and machine.held:
            same = rng.random(1 if machine.together else len(bpms)) < machine.held
            reading = np.where(same, orbits[tick - 1], reading)
        orbits[tick], setpoints[tick] = reading, now
        now = now - machine.loop * inverse @ (reading - golden[tick]) + dither[tick]
        if machine.step:
            now = np.round(now / machine.step) * machine.step
    read = orbits[WARM:]
    read[rng.random(read.shape) < machine.invalid] = np.nan
    for _ in range(machine.spikes):
        away = rng.choice([-1.0, 1.0]) * rng.uniform(5e-6, 100e-6)
        read[rng.integers(5, machine.rows - 5), rng.integers(len(bpms))] += away
    kept = setpoints[WARM:]
    return {
        "t": np.arange(machine.rows) * PERIOD,
        "orbit": read[:-1] * 1e3,
        "next_orbit": read[1:] * 1e3,
        "setpoint": kept[:-1],
        "action": np.diff(kept, axis=0),
        "reference": golden[WARM:-1] * 1e3,
    }


def _motion(machine: Machine, rng: Rng, sources: Array, rows: int) -> Array:
    """Orbit that no corrector makes, shape (rows, n) [m]."""

    def coloured(power: float) -> Array:
        frequency = np.fft.rfftfreq(4 * rows, PERIOD)
        frequency[0] = frequency[1]
        drawn = np.fft.rfft(rng.standard_normal((4 * rows, sources.shape[1])), axis=0)
        return np.fft.irfft(drawn * (frequency ** (-0.5 * power))[:, None], axis=0)[:rows]

    if machine.damped:
        moved = rng.standard_normal((rows, sources.shape[1]))
        for tick in range(1, rows):
            moved[tick] += (1.0 - machine.damped) * moved[tick - 1]
    elif machine.colour == 2.0:
        moved = np.cumsum(rng.standard_normal((rows, sources.shape[1])), axis=0)
    else:
        moved = coloured(machine.colour)
    orbit = moved @ sources.T
    orbit *= machine.ground / np.sqrt(np.mean(np.diff(orbit, axis=0) ** 2))
    few = rng.choice(sources.shape[1], machine.sources, replace=False)
    parts = [
        (machine.shaking, rng.standard_normal((rows, len(few))) @ sources[:, few].T),
        (machine.flicker, coloured(1.0) @ sources.T),
    ]
    for size, part in parts:
        orbit = orbit + size * part / np.sqrt(np.mean(part**2))
    return orbit
