"""Colour of the reading noise of all BPMs together: the floor has their level, not their colour.

Whittle's likelihood of the steps of what is left, in modes that hardly walk: their spectrum is
q + r² |1 − exp(iω)|² times the colour. Level r² and every mode's q are fitted anew beside each
colour, so that a gain is one of the colour alone. Modes that walk are left out: drift may have a
memory of its own.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate, held_to
from orbitfb.diagnose.explain import Cause, explain
from orbitfb.diagnose.innovation import stretches
from orbitfb.diagnose.standing import stretches_across
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix

_STILL = 0.15
"""Steady gain of the filter up to which a mode hardly walks."""
_FEWEST_MODES, _FEWEST_ROWS = 20, 200
_BINS = 40
_COLOURS = np.concatenate([-np.geomspace(0.8, 0.01, 14), np.geomspace(0.01, 0.8, 14)])
_LEVELS = np.exp(np.linspace(-0.5, 0.5, 21))
_WALKS = np.concatenate([[0.0], np.exp(np.linspace(-13.0, 0.5, 24))])
"""Ratios q / r² that are tried."""
_HEALTHY = 0.02
"""Scatter of the correlation of healthy noise between neighbouring ticks."""


def colour_of_all(bench: Bench, kind: NoiseKind) -> Candidate | None:
    """Try noise of one colour in all BPMs; None where there is too little to tell.

    Args:
        bench: The record under the causes accepted so far.
        kind: Coloured noise, whose first parameter is a correlation.
    """
    parts = _spectra(bench)
    if parts is None:
        return None
    power, weight, turn = parts
    reading = bench.floor.reading
    name = kind.parameters[0].name

    def cost(colour: float) -> float:
        values = {p.name: p.typical for p in kind.parameters} | {name: colour}
        white = np.abs(1.0 - turn) ** 2
        shape = white + kind.spectrum(values, 1.0, turn)
        return min(_cost(power / (reading * level), shape, weight, level) for level in _LEVELS)

    nothing = cost(0.0)
    costs = np.array([cost(float(colour)) for colour in _COLOURS])
    best = int(np.argmin(costs))
    colour, gain = float(_COLOURS[best]), nothing - float(costs[best])
    if gain <= 0.0:
        return None
    sure = float(held_to(np.array([gain]), np.array([colour / _HEALTHY]))[0])
    values = {p.name: p.typical for p in kind.parameters} | {name: _refined(costs, best)}
    places = tuple(range(len(bench.record.layout.bpms)))
    return Candidate(Cause(kind, places, values), sure, 1.0, "all", gain)


def _cost(power: Matrix, shape: Vector, weight: Vector, level: float) -> float:
    """Minus the log-likelihood of a level and colour, each mode with its best walk [nats]."""
    density = _WALKS[:, None] + shape  # (walks, bins), over r²
    logs = np.log(level * density) @ weight
    ratios = (weight / density) @ power  # (walks, modes)
    return float(np.sum(np.min(logs[:, None] + ratios, axis=0)))


def _refined(costs: Vector, best: int) -> float:
    """Colour at the lowest point of the parabola through the best one and its neighbours."""
    at = slice(max(best - 1, 0), best + 2)
    own, height = _COLOURS[at], costs[at]
    if len(own) < 3:
        return float(_COLOURS[best])
    bend, slope, _ = np.polyfit(own, height, 2)
    if bend <= 0.0:
        return float(_COLOURS[best])
    return float(np.clip(-0.5 * slope / bend, own.min(), own.max()))


def _spectra(bench: Bench) -> tuple[Matrix, Vector, np.ndarray] | None:
    """Mean power (bins, modes) [m²] of the steps, lines per bin, and exp(−iω) of every bin."""
    floor, record = bench.floor, bench.record
    still = np.flatnonzero(floor.gains < _STILL)
    pieces = stretches(stretches_across(record, bench.causes))
    longest = max(pieces, key=lambda part: part.stop - part.start)
    if len(still) < _FEWEST_MODES or longest.stop - longest.start < _FEWEST_ROWS:
        return None
    left = explain(record, bench.causes, bench.orbit).left - bench.background.orbit(bench.sizes)
    steps = np.diff(floor.to_modes(left)[longest][:, still], axis=0)
    window = np.hanning(len(steps) + 2)[1:-1]
    lines = np.fft.rfft(steps * (window / np.sqrt(np.sum(window**2)))[:, None], axis=0)[1:-1]
    power = np.abs(lines) ** 2
    count = max(len(power) // _BINS, 1)
    bins = len(power) // count
    angle = 2.0 * np.pi * np.arange(1, bins * count + 1) / len(steps)
    mean = power[: bins * count].reshape(bins, count, -1).mean(axis=1)
    # Neighbouring lines share a window: so many of them count.
    share = float(np.sum(window**2) ** 2 / (np.sum(window**4) * len(window)))
    turn = np.exp(-1j * angle.reshape(bins, count).mean(axis=1))
    return mean, np.full(bins, count * share), turn
