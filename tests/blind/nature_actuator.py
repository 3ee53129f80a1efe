"""Correctors and the way to them, as nature makes them."""

import numpy as np

from tests.blind.conditions import Conditions
from tests.blind.draft import Draft, kind
from tests.blind.machine import Nature
from tests.blind.nature_sensor import Swapped, named, neighbours, one_or_cell, sign
from tests.blind.rings import Array, Index

Rng = np.random.Generator


class OnCurrent(Nature):
    """Something that correctors make of their setpoints."""

    def __init__(self, columns: Index) -> None:
        self.columns = columns

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.case, self.rng, self.memory = case, rng, None

    def drive(self, row: int, wanted: Array) -> Array:
        """Currents of the columns from the setpoints sent."""
        raise NotImplementedError

    def currents(self, row: int, wanted: Array) -> Array:
        driven = wanted.copy()
        driven[self.columns] = self.drive(row, wanted[self.columns])
        return driven


class Scaled(OnCurrent):
    def __init__(self, columns: Index, gain: float) -> None:
        super().__init__(columns)
        self.gain = gain

    def drive(self, row: int, wanted: Array) -> Array:
        return wanted * (1 + self.gain)


@kind("corrector-gain", "actuator")
def corrector_gain(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.corr_names, rng), sign(rng)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Scaled(columns, way * s),
        lambda s: {"gain": (way * s, "1")},
        0.15,
        0.95,
        least=0.05,
    )


@kind("corrector-polarity", "actuator", unstable=True)
def corrector_polarity(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.0)
    return Draft(
        named(case.corr_names, columns), lambda s: Scaled(columns, -2.0), lambda s: {}, 0.0, 0.0
    )


@kind("corrector-swap", "actuator", unstable=True)
def corrector_swap(case: Conditions, rng: Rng) -> Draft:
    pair = neighbours(case, case.corr_names, rng)
    return Draft(
        named(case.corr_names, pair), lambda s: Swapped(pair, "corrector"), lambda s: {}, 0.0, 0.0
    )


class Stuck(OnCurrent):
    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy()
        return self.memory


@kind("corrector-stuck", "actuator", unstable=True)
def corrector_stuck(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.0)
    return Draft(named(case.corr_names, columns), lambda s: Stuck(columns), lambda s: {}, 0.0, 0.0)


class Slew(OnCurrent):
    """A supply that drives its magnet at a limited rate, from the write to the reading."""

    def __init__(self, columns: Index, rate: float) -> None:
        super().__init__(columns)
        self.rate = rate

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), wanted.copy()
        before, here = self.memory
        period, delay = self.case.period, self.case.delay
        for aim, time in ((before, delay * period), (wanted, (1 - delay) * period)):
            here = here + np.clip(aim - here, -self.rate * time, self.rate * time)
        self.memory = wanted.copy(), here
        return here


def usual_step(case: Conditions) -> float:
    """Rough size of a loop's step of a setpoint [A]."""
    step = case.gain * np.sqrt(np.mean((case.controller * case.noise) ** 2) * len(case.noise))
    moves = np.diff(case.dither[:300], axis=0)
    return float(np.hypot(step, np.sqrt(np.mean(moves**2)) if moves.size else 0.0))


@kind("corrector-slew", "actuator")
def corrector_slew(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    step = usual_step(case) / case.period
    return Draft(
        named(case.corr_names, columns),
        lambda s: Slew(columns, step / s),
        lambda s: {"rate": (step / s, "A/s")},
        1.0,
        300.0,
    )


class Lag(OnCurrent):
    """First order in continuous time: the current of a coil, or the field behind a chamber."""

    def __init__(self, columns: Index, tau: float, tau2: float = 0.0) -> None:
        super().__init__(columns)
        self.taus = [tau] if not tau2 else [tau, tau2]

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), [wanted.copy() for _ in self.taus]
        before, states = self.memory
        period, delay = self.case.period, self.case.delay
        after = []
        for tau, state in zip(self.taus, states, strict=True):
            state = before + (state - before) * np.exp(-delay * period / tau)
            after.append(wanted + (state - wanted) * np.exp(-(1 - delay) * period / tau))
        self.memory = wanted.copy(), after
        return np.mean(after, axis=0)


@kind("corrector-lag", "actuator")
def corrector_lag(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Lag(columns, s * case.period),
        lambda s: {"tau": (s * case.period, "s")},
        0.6,
        20.0,
    )


class Resonance(OnCurrent):
    """A supply that rings: ẍ + 2ζω ẋ + ω² x = ω² u, integrated in 40 steps per tick."""

    def __init__(self, columns: Index, turns: float, damping: float) -> None:
        super().__init__(columns)
        self.turns, self.damping = turns, damping

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), wanted.copy(), np.zeros_like(wanted)
        before, place, speed = self.memory
        omega, step = 2 * np.pi * self.turns, 1 / 40  # time in ticks
        for part in range(40):
            aim = before if (part + 0.5) * step < self.case.delay else wanted
            half = speed + step / 2 * (omega**2 * (aim - place) - 2 * self.damping * omega * speed)
            place = place + step * half
            speed = (half + step / 2 * omega**2 * (aim - place)) / (1 + step * self.damping * omega)
        self.memory = wanted.copy(), place, speed
        return place


@kind("corrector-resonance", "actuator")
def corrector_resonance(case: Conditions, rng: Rng) -> Draft:
    columns, damping = one_or_cell(case, case.corr_names, rng, 0.3), rng.uniform(0.15, 0.5)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Resonance(columns, 1 / (s * 2 * np.pi), damping),
        lambda s: {
            "frequency": (1 / (s * 2 * np.pi * case.period), "Hz"),
            "damping": (damping, "1"),
        },
        0.4,
        1.6,
    )


class Steps(OnCurrent):
    """A converter of coarse steps that are offset from zero."""

    def __init__(self, columns: Index, step: float, offset: Array) -> None:
        super().__init__(columns)
        self.step, self.offset = step, offset

    def drive(self, row: int, wanted: Array) -> Array:
        return self.step * (np.floor(wanted / self.step + self.offset) + 0.5 - self.offset)


@kind("corrector-quantisation", "actuator", onset="start")
def corrector_quantisation(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.5)
    offset = np.full(len(columns), 0.5)  # steps through zero, as a 16-bit word has them
    unit = usual_step(case)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Steps(columns, s * unit, offset),
        lambda s: {"step": (s * unit, "A")},
        2.0,
        300.0,
    )


class Dead(OnCurrent):
    """Follows only when the setpoint is farther than the width; then it goes all the way."""

    def __init__(self, columns: Index, width: float) -> None:
        super().__init__(columns)
        self.width = width

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy()
        self.memory = np.where(np.abs(wanted - self.memory) > self.width, wanted, self.memory)
        return self.memory


@kind("corrector-deadband", "actuator")
def corrector_deadband(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    unit = usual_step(case)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Dead(columns, s * unit),
        lambda s: {"width": (s * unit, "A")},
        1.0,
        300.0,
    )


class Clipped(OnCurrent):
    def __init__(self, columns: Index, low: Array, high: Array) -> None:
        super().__init__(columns)
        self.low, self.high = low, high

    def drive(self, row: int, wanted: Array) -> Array:
        return np.clip(wanted, self.low, self.high)


class SoftLimit(OnCurrent):
    """A supply that runs out of voltage softly: a corner rounded over 2 % of the limit."""

    def __init__(self, columns: Index, limit: float) -> None:
        super().__init__(columns)
        self.limit = limit

    def drive(self, row: int, wanted: Array) -> Array:
        soft, size = 0.02 * self.limit, np.abs(wanted)
        over = np.logaddexp(0.0, (size - self.limit) / soft) * soft
        return np.sign(wanted) * (size - over)


@kind("corrector-saturation", "actuator")
def corrector_saturation(case: Conditions, rng: Rng) -> Draft:
    from tests.blind.machine import run

    calm = run(case, [], 1).setpoints
    # The limit lies within the reach of the setpoint of a corrector that is not near zero.
    sizes = np.abs(calm).mean(axis=0)
    busy = np.flatnonzero(sizes > np.median(sizes))
    column = int(rng.choice(busy))
    top, reach = np.abs(calm[:, column]).max(), np.ptp(calm[:, column])
    columns = np.array([column])
    return Draft(
        named(case.corr_names, columns),
        lambda s: SoftLimit(columns, max(top - s * reach, 0.02 * top)),
        lambda s: {"limit": (max(top - s * reach, 0.02 * top), "A")},
        0.5,
        10.0,
    )


class BoucWen(OnCurrent):
    """Hysteresis: z' = u' − (β sign(u' z) + γ) |z|ᵏ u', θ = u − share · z, |z| ≤ width."""

    def __init__(self, columns: Index, width: float, share: float) -> None:
        super().__init__(columns)
        self.width, self.share = width, share

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), np.zeros_like(wanted)
        before, lag = self.memory
        for _ in range(8):
            move = (wanted - before) / 8
            near = np.minimum(np.abs(lag) / self.width, 1.0) ** 2
            lag = lag + move * (1 - near * (0.7 * np.sign(move * lag) + 0.3))
        lag = np.clip(lag, -self.width, self.width)
        self.memory = wanted.copy(), lag
        return wanted - self.share * lag


@kind("corrector-hysteresis", "actuator")
def corrector_hysteresis(case: Conditions, rng: Rng) -> Draft:
    columns, unit = one_or_cell(case, case.corr_names, rng, 0.3), usual_step(case)
    return Draft(
        named(case.corr_names, columns),
        lambda s: BoucWen(columns, s * unit, 1.0),
        lambda s: {"width": (2 * s * unit, "A")},
        1.0,
        300.0,
    )


class Leak(Nature):
    """A share of one corrector's current drives another."""

    def __init__(self, giver: int, taker: int, share: float) -> None:
        self.giver, self.taker, self.share = giver, taker, share

    def currents(self, row: int, wanted: Array) -> Array:
        driven = wanted.copy()
        driven[self.taker] += self.share * wanted[self.giver]
        return driven


@kind("corrector-crosstalk", "actuator")
def corrector_crosstalk(case: Conditions, rng: Rng) -> Draft:
    pair, way = rng.permutation(neighbours(case, case.corr_names, rng)), sign(rng)
    giver, taker = int(pair[0]), int(pair[1])
    return Draft(
        named(case.corr_names, pair),
        lambda s: Leak(giver, taker, way * s),
        lambda s: {"coupling": (way * s, "1")},
        0.1,
        1.0,
    )


class Turned(Nature):
    def __init__(self, pair: tuple[int, int], ratio: float, angle: float) -> None:
        self.pair, self.ratio, self.angle = pair, ratio, angle

    def currents(self, row: int, wanted: Array) -> Array:
        i, j = self.pair
        driven = wanted.copy()
        c, s = np.cos(self.angle), np.sin(self.angle)
        # A rotation of the kicks; the currents of both planes differ by their calibrations.
        driven[i] = c * wanted[i] - s * wanted[j] / self.ratio
        driven[j] = c * wanted[j] + s * wanted[i] * self.ratio
        return driven


@kind("corrector-roll", "actuator", planes="xy")
def corrector_roll(case: Conditions, rng: Rng) -> Draft:
    i, way = int(rng.integers(len(case.correctors))), sign(rng)
    ring = case.lattice.ring
    ratio = float(ring.calibration("x")[i] / ring.calibration("y")[i])
    return Draft(
        [case.corr_names[i]],
        lambda s: Turned((i, i + len(case.correctors)), ratio, way * s),
        lambda s: {"angle": (way * s, "rad")},
        0.15,
        1.2,
    )


class LateWrite(OnCurrent):
    """Everything written acts a while later."""

    def __init__(self, columns: Index, ticks: float) -> None:
        super().__init__(columns)
        self.ticks = ticks

    def drive(self, row: int, wanted: Array) -> Array:
        whole = int(np.floor(self.ticks))
        if self.memory is None:
            self.memory = [wanted.copy()] * (whole + 2)
        self.memory = [wanted.copy(), *self.memory[: whole + 1]]
        part = self.ticks - whole
        return (1 - part) * self.memory[whole] + part * self.memory[whole + 1]


@kind("loop-delay", "timing")
def loop_delay(case: Conditions, rng: Rng) -> Draft:
    columns = np.arange(len(case.corr_names))
    return Draft(
        [],
        lambda s: LateWrite(columns, s),
        lambda s: {"delay": (s * case.period, "s")},
        0.1,
        2.0,
    )


class Missed(Nature):
    """Now and then nothing that was sent arrives; the next tick sends absolute setpoints."""

    def __init__(self, chance: float) -> None:
        self.chance = chance

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.luck, self.memory = rng.random(case.rows), None

    def currents(self, row: int, wanted: Array) -> Array:
        if self.memory is None or self.luck[row] >= self.chance:
            self.memory = wanted.copy()
        return self.memory


@kind("missed-write", "timing", onset="start")
def missed_write(case: Conditions, rng: Rng) -> Draft:
    return Draft(
        [],
        lambda s: Missed(s),
        lambda s: {"probability": (s, "1")},
        0.01,
        0.3,
        law="rare",
        least=0.003,
    )
