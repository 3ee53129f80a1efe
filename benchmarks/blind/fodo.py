"""A second generator, small and independent: records of a ring of FODO cells, with their truth.

It imports nothing of the package that is checked. Closed orbits come from one-turn matrices of thin
lenses, quadrupoles wander and shake the beam, a Tikhonov loop corrects it to golden orbits that
step. A record takes a tenth of a second; its devices are in no table of places.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CELLS, HALF_CELL, FOCAL = 12, 4.0, 4.1
"""Cells, length of half a cell [m], focal length of its lenses [m]: 58° of phase a cell."""
PERIOD, TICKS, WARM = 0.1, 900, 60
"""Period [s], transitions of a record, ticks before it in which the loop settles."""
GROUND, NOISE, STEERING = 0.04e-6, 0.2e-6, 15e-6
"""Orbit by the ground per tick, reading noise, step of the golden orbit, rms [m]."""
KICK = 50e-6
"""Of a corrector per ampere [rad/A]."""
GRADIENTS = 0.001
"""Errors of the lenses of a healthy ring, of their strength [1]: the response is then 2 % from the
model, as two measured ones differ by (5 times as much makes 12 %, which is a fault)."""
EASY, MEDIUM = 1.0, 0.4
"""sqrt(ratio² − 1) of the one-step errors with and without the effect; of one device the larger of
that and half of the worst BPM's."""


@dataclass(slots=True)
class Effect:
    """An effect, by what it changes; each part is called with the tick.

    Args:
        word: What `external.toml` calls it.
        bpms: Columns that it sits on.
        correctors: Columns that it sits on.
        figures: Its parameters.
        act: From setpoints in force to currents of the magnets [A].
        kick: Further kicks of the quadrupoles [rad].
        read: From orbit with noise to readings [m].
        louder: Factor of the reading noise.
    """

    word: str
    bpms: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    correctors: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    figures: dict[str, float] = field(default_factory=dict)
    act: Callable[[int, Array], Array] = lambda tick, currents: currents
    kick: Callable[[int], Array | float] = lambda tick: 0.0
    read: Callable[[int, Array], Array] = lambda tick, orbit: orbit
    louder: Callable[[int], Array | float] = lambda tick: 1.0


def response(errors: Array) -> Array:
    """Orbit at the BPMs per kick of correctors, or of quadrupoles [m/rad], by one-turn matrices.

    A BPM stands in the middle of a lens and so does a corrector; lenses alternate.

    Args:
        errors: Relative gradient errors of the 2 × CELLS lenses.
    """
    count = len(errors)
    half = [
        np.array([[1.0, 0.0], [-(1 - 2 * (lens % 2)) * (1 + error) / (2 * FOCAL), 1.0]])
        for lens, error in enumerate(errors)
    ]
    drift = np.array([[1.0, HALF_CELL], [0.0, 1.0]])
    step = [half[(k + 1) % count] @ drift @ half[k] for k in range(count)]
    found = np.zeros((count, count))
    for source in range(count):
        turn = np.eye(2)
        for k in range(count):
            turn = step[(source + k) % count] @ turn
        # Behind the kick: x = M x + (0, 1), closed; then transported from lens to lens.
        orbit = np.linalg.solve(np.eye(2) - turn, np.array([0.0, 1.0]))
        for k in range(count):
            found[(source + k) % count, source] = orbit[0]
            orbit = step[(source + k) % count] @ orbit
    return found


def run(effect: Effect, seed: int, dither: float, sent: Array | None = None) -> dict[str, Array]:
    """Run the loop; with given setpoints, replay them under the same ground and noise.

    Args:
        effect: What is wrong; called in the order of the ticks.
        seed: Of everything random.
        dither: White noise on the requested changes, as orbit, rms [m].
        sent: Setpoints of every tick, shape (rows, m) [A].
    """
    rng = np.random.default_rng([seed, 1])
    n = 2 * CELLS
    model = response(np.zeros(n)) * KICK
    ground = response(GRADIENTS * rng.standard_normal(n))
    plant = ground * KICK * (1 + 0.01 * rng.standard_normal(n))
    gains = 1 + 0.01 * rng.standard_normal(n)
    rows = WARM + TICKS + 1
    moves = rng.standard_normal((rows, n))
    moves *= GROUND / np.sqrt(np.mean((moves @ ground.T) ** 2))
    moves[0] += 400 * moves[1]
    noise = NOISE * np.exp(0.1 * rng.standard_normal(n)) * rng.standard_normal((rows, n))
    modes, size, right = np.linalg.svd(model)
    inverse = (right.T * (size / (size**2 + (0.02 * size[0]) ** 2))) @ modes.T
    golden = np.zeros((rows, n))
    for tick in range(40, rows, 70):
        shape = modes[:, :10] @ rng.standard_normal(10)
        golden[tick:] += STEERING * shape / np.sqrt(np.mean(shape**2))
    white = rng.standard_normal((rows, n))
    white *= dither / np.sqrt(np.mean((white[:200] @ model.T) ** 2))
    orbits, setpoints = np.zeros((rows, n)), np.zeros((rows, n))
    actions = np.zeros((rows, n))
    place, now = np.zeros(n), np.zeros(n)
    for tick in range(rows):
        place = place + moves[tick]
        orbit = plant @ effect.act(tick, now) + ground @ (place + effect.kick(tick))
        orbits[tick] = effect.read(tick, gains * orbit + effect.louder(tick) * noise[tick])
        setpoints[tick] = now
        if sent is not None:
            now = sent[min(tick + 1, rows - 1)]
        else:
            actions[tick] = -0.5 * inverse @ (orbits[tick] - golden[tick]) + white[tick]
            now = now + actions[tick]
    return {
        "orbit": orbits,
        "setpoint": setpoints,
        "action": actions,
        "model": model,
        "golden": golden,
    }


def make(word: str, seed: int, out: Path, truths: Path) -> str:
    """Write a record and its truth; give its name.

    Args:
        word: The effect, one of `EFFECTS`; `none` for a healthy machine.
        seed: Of everything drawn.
        out: Folder for the record.
        truths: Folder for its truth.
    """
    rng = np.random.default_rng([seed, 2])
    dither = 1.5e-6 if rng.random() < 0.5 else 0.0
    state = rng.bit_generator.state
    log = run(EFFECTS[word](rng), seed, dither)
    rng.bit_generator.state = state
    effect = EFFECTS[word](rng)  # the same once more, for its places
    without = run(Effect("none"), seed, 0.0, log["setpoint"])
    kept, after = slice(WARM, WARM + TICKS), slice(WARM + 1, WARM + TICKS + 1)
    names = label(range(2 * CELLS), range(2 * CELLS))
    arrays = {
        "t": np.arange(TICKS) * PERIOD,
        "orbit": log["orbit"][kept] * 1e3,
        "next_orbit": log["orbit"][after] * 1e3,
        "setpoint": log["setpoint"][kept],
        "action": log["action"][kept],
        "reference": log["golden"][kept] * 1e3,
    }
    whole, worst = _seen(log, without, kept, after)
    local = 0 < len(effect.bpms) + len(effect.correctors) < 2 * CELLS
    size = max(whole, worst / 2) if local else whole
    level = "null" if word == "none" else _level(size)
    shrink = None if word in ("none", "noise_level_drift") else 1.0
    told = truth_of(replace(effect, word=word), names, local, level, shrink)
    return save(f"{seed:06d}", out, truths, arrays, log["model"], names, told)


def label(bpms: Iterable[int], correctors: Iterable[int]) -> tuple[list[str], list[str]]:
    """Names of the devices at some lenses."""
    return [f"B{k:02d}" for k in bpms], [f"C{k:02d}" for k in correctors]


def truth_of(
    effect: Effect,
    names: tuple[list[str], list[str]],
    local: bool,
    level: str,
    shrink: float | None,
) -> dict[str, Any]:
    """The truth of a record, as its file has it.

    Args:
        effect: What is wrong.
        names: Of the BPMs and of the correctors.
        local: Whether it sits at single devices.
        level: How hard it is to see.
        shrink: Share of what it does that knowing it removes; None: not told.
    """
    its = {
        "effect": effect.word,
        "localised": local,
        "bpm_names": [names[0][k] for k in effect.bpms],
        "corr_names": [names[1][k] for k in effect.correctors],
        "params": effect.figures,
    }
    return {"effects": [its], "difficulty": level, "measured": {"shrink": shrink}}


def save(
    name: str,
    out: Path,
    truths: Path,
    arrays: dict[str, Any],
    model: Array,
    names: tuple[list[str], list[str]],
    told: dict[str, Any],
) -> str:
    """Write a record and its truth; give its name.

    Args:
        name: Of both.
        out: Folder for the record.
        truths: Folder for its truth.
        arrays: By name, in the units of the file.
        model: Response, shape (n, m) [m/A].
        names: Of the BPMs and of the correctors.
        told: The truth.
    """
    meta = {"dt_s": PERIOD, "planes": "x", "units": {"orbit": "mm", "action": "A", "setpoint": "A"}}
    for folder in (out, truths):
        folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        out / f"{name}.npz",
        model_R=model * 1e3,
        bpm_names=np.array(names[0]),
        corr_names=np.array(names[1]),
        meta=np.array(json.dumps(meta)),
        **arrays,
    )
    (truths / f"{name}.truth.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    return name


def _seen(
    log: dict[str, Array], without: dict[str, Array], kept: slice, after: slice
) -> tuple[float, float]:
    """Excess of the one-step error by the effect, over that without it: all BPMs, the worst."""
    moved = np.diff(log["setpoint"], axis=0)[kept] @ log["model"].T
    power = [
        np.mean((its["orbit"][after] - its["orbit"][kept] - moved) ** 2, axis=0)
        for its in (log, without)
    ]
    ratio = float(power[0].sum() / power[1].sum()), float((power[0] / power[1]).max())
    return (max(ratio[0] - 1, 0.0) ** 0.5, max(ratio[1] - 1, 0.0) ** 0.5)


def _level(size: float) -> str:
    return "easy" if size >= EASY else "medium" if size >= MEDIUM else "hard"


def _some(rng: np.random.Generator, count: int) -> NDArray[np.intp]:
    return np.sort(rng.choice(2 * CELLS, count, replace=False))


def _scaled(rng: np.random.Generator, count: int) -> tuple[NDArray[np.intp], Array]:
    """Devices and the factors of all: those are off by 15 to 30 per cent."""
    places = _some(rng, count)
    factors = np.ones(2 * CELLS)
    factors[places] += rng.choice([-1, 1], count) * rng.uniform(0.15, 0.3, count)
    return places, factors


def _corrector_gain(rng: np.random.Generator) -> Effect:
    places, factors = _scaled(rng, 3)
    return Effect("", correctors=places, act=lambda tick, currents: currents * factors)


def _bpm_gain(rng: np.random.Generator) -> Effect:
    places, factors = _scaled(rng, 3)
    return Effect("", bpms=places, read=lambda tick, orbit: orbit * factors)


def _lag(rng: np.random.Generator) -> Effect:
    """Currents of a cell go exponentially to their setpoints."""
    first = int(rng.integers(CELLS))
    places, tau = np.array([2 * first, 2 * first + 1]), rng.uniform(0.06, 0.12)
    there = np.zeros(2)

    def act(tick: int, currents: Array) -> Array:
        there[:] = currents[places] + (there - currents[places]) * np.exp(-PERIOD / tau)
        slow = currents.copy()
        slow[places] = there
        return slow

    return Effect("", correctors=places, figures={"tau_s": float(tau)}, act=act)


def _delay(rng: np.random.Generator) -> Effect:
    """All currents come a tick late."""
    last = np.zeros(2 * CELLS)

    def act(tick: int, currents: Array) -> Array:
        late = last.copy()
        last[:] = currents
        return late

    return Effect("", figures={"ticks": 1.0}, act=act)


def _stuck(rng: np.random.Generator) -> Effect:
    """A current stays where it is from a tick on."""
    place, onset = int(rng.integers(2 * CELLS)), WARM + int(rng.uniform(0.3, 0.5) * TICKS)
    held = np.zeros(1)

    def act(tick: int, currents: Array) -> Array:
        if tick <= onset:
            held[0] = currents[place]
        stuck = currents.copy()
        stuck[place] = held[0]
        return stuck

    return Effect("", correctors=np.array([place]), act=act)


def _frozen(rng: np.random.Generator) -> Effect:
    """A BPM tells the same from a tick on."""
    place, onset = int(rng.integers(2 * CELLS)), WARM + int(rng.uniform(0.3, 0.5) * TICKS)
    held = np.zeros(1)

    def read(tick: int, orbit: Array) -> Array:
        if tick <= onset:
            held[0] = orbit[place]
        frozen = orbit.copy()
        frozen[place] = held[0]
        return frozen

    return Effect("", bpms=np.array([place]), read=read)


def _play(rng: np.random.Generator) -> Effect:
    """Currents follow with a play: the backlash of a gear."""
    width = rng.uniform(0.01, 0.02)
    there = np.zeros(2 * CELLS)

    def act(tick: int, currents: Array) -> Array:
        there[:] = np.clip(there, currents - width, currents + width)
        return there.copy()

    return Effect("", act=act)


def _line(rng: np.random.Generator) -> Effect:
    """A quadrupole shakes with one frequency."""
    kick = np.zeros(2 * CELLS)
    kick[int(rng.integers(2 * CELLS))] = rng.uniform(0.1e-6, 0.2e-6)
    turn = 2 * np.pi * rng.uniform(0.6, 3.0) * PERIOD
    return Effect("", kick=lambda tick: kick * np.sin(turn * tick))


def _louder(rng: np.random.Generator) -> Effect:
    """The noise of some BPMs is several times what it was from the middle on."""
    places = _some(rng, 4)
    factors = np.ones(2 * CELLS)
    factors[places] = rng.uniform(3.0, 5.0)
    middle = WARM + TICKS // 2
    return Effect("", bpms=places, louder=lambda tick: factors if tick >= middle else 1.0)


EFFECTS: dict[str, Callable[[np.random.Generator], Effect]] = {
    "none": lambda rng: Effect("none"),
    "corrector_calibration": _corrector_gain,
    "bpm_gain": _bpm_gain,
    "corrector_lag": _lag,
    "transport_delay": _delay,
    "corrector_stuck": _stuck,
    "bpm_dead": _frozen,
    "corrector_backlash": _play,
    "periodic_disturbance": _line,
    "noise_level_drift": _louder,
}
"""By the words of `external.toml`; everything that is drawn is drawn anew for a seed."""


def generate(seed: int, out: Path, count: int) -> list[str]:
    """Write records: every effect in turn, as many without one as of each other kind.

    Args:
        seed: Of the first record; the next one has the next seed.
        out: Folder for the records; the truth goes beside it.
        count: Records.
    """
    truths, words = out.with_name(f"{out.name}_truth"), list(EFFECTS)
    return [make(words[k % len(words)], seed + k, out, truths) for k in range(count)]
