"""Effects as parts of the plant: from their settings, on the devices that these name."""

import copy
from collections import Counter
from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.places import resolve
from orbitfb.effects.settings import EffectSettings
from orbitfb.physics.effect import Effect, generator
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring, split
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.response import response as nominal_response
from orbitfb.records.devices import devices_of
from orbitfb.records.layout import Layout


class Since(Effect):
    """An effect that begins at a tick; before, everything passes.

    Args:
        effect: The effect.
        begin: First tick that has it.
        own_clock: Whether its time is 0 at that tick, so that it grows from nothing there.
    """

    def __init__(self, effect: Effect, begin: int, own_clock: bool) -> None:
        self._effect, self._begin = effect, begin
        self._zero = begin if own_clock else 0

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Act from the beginning on."""
        if tick < self._begin:
            return setpoints
        return self._effect.actuate(setpoints, tick - self._zero)

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        """Act from the beginning on."""
        if tick < self._begin:
            return orbit
        return self._effect.respond(orbit, currents, tick - self._zero)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Act from the beginning on."""
        if tick < self._begin:
            return orbit
        return self._effect.disturb(orbit, tick - self._zero)

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Act from the beginning on."""
        if tick < self._begin:
            return orbit
        return self._effect.sense(orbit, tick - self._zero)


def layout_of(ring: Ring, planes: Planes, period: float, response: Matrix | None = None) -> Layout:
    """Describe the devices of a ring.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        period: From one orbit to the next [s].
        response: Nominal response, shape (n, m) [m/A]; that of the optics when None.
    """
    each, channels = split(planes), ring.channels(planes)
    return Layout(
        bpms=devices_of(channels.bpms, [plane for plane in each for _ in ring.names("BPM", plane)]),
        correctors=devices_of(
            channels.correctors, [plane for plane in each for _ in ring.names("COR", plane)]
        ),
        response=nominal_response(ring, planes) if response is None else response,
        period=period,
        ring=ring,
    )


def build(settings: Sequence[EffectSettings], layout: Layout, seed: int) -> tuple[Effect, ...]:
    """Make effects for the plant, in their order.

    Every one has its own random numbers, from the seed, its id, and its number among those of
    the same id.

    Args:
        settings: Of the effects.
        layout: Of the ring that gets them.
        seed: Of the plant.

    Raises:
        ConfigError: An effect is to be where nothing is.
    """
    made: list[Effect] = []
    count: Counter[str] = Counter()
    for its in settings:
        count[its.id] += 1
        rng = generator(seed, f"effect {its.id} {count[its.id]}")
        places = resolve(its, layout)
        if its.elements:
            effect = its.kind.with_elements(layout, places, its.elements)
        else:
            effect = its.kind.simulate(layout, places, its.filled, rng)
        begin = round(its.since / layout.period)
        made.append(Since(effect, begin, its.kind.grows) if begin > 0 else effect)
    return tuple(made)


def plant_with(
    ring: Ring,
    planes: Planes,
    settings: PlantSettings,
    seed: int,
    effects: Sequence[EffectSettings],
    period: float,
    first: Sequence[Effect] = (),
) -> Plant:
    """Make a ring with effects.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: What it suffers from besides.
        seed: Of every random number.
        effects: Their settings.
        period: From one orbit to the next [s].
        first: Effects that are made already, before the others.

    Raises:
        ConfigError: An effect is to be where nothing is.
    """
    built = build(effects, layout_of(ring, planes, period), seed) if effects else ()
    return Plant(ring, planes, settings, seed, (*first, *built))


def measured_response(
    layout: Layout,
    effects: Sequence[EffectSettings],
    seed: int,
    step: float = 0.1,
    ticks: int = 30,
) -> Matrix:
    """Tell what a slow measurement of the response would find with effects, noise averaged out.

    Every corrector is set to +step and, on a ring of its own with the same random numbers, to
    −step; the difference of the readings after some ticks is what it does.

    Args:
        layout: Of the ring.
        effects: Their settings; all are there from the beginning.
        seed: Of their random numbers.
        step: Size of the steps [A].
        ticks: How long every step is held.

    Returns:
        Shape (n, m) [m/A].
    """
    fresh = build([its.model_copy(update={"since": 0.0}) for its in effects], layout, seed)
    nothing = np.zeros(layout.response.shape[1])
    _read(fresh, layout.response, nothing, 0)
    found = np.zeros_like(layout.response)
    for column in range(found.shape[1]):
        for sign in (1.0, -1.0):
            its = copy.deepcopy(fresh, {id(layout): layout})
            setpoints = nothing.copy()
            setpoints[column] = sign * step
            for tick in range(1, ticks):
                _read(its, layout.response, setpoints, tick)
            end = _read(its, layout.response, setpoints, ticks)
            found[:, column] += sign * end / (2.0 * step)
    return found


def _read(effects: Sequence[Effect], response: Matrix, setpoints: Vector, tick: int) -> Vector:
    for effect in effects:
        setpoints = effect.actuate(setpoints, tick)
    orbit = response @ setpoints
    for effect in effects:
        orbit = effect.respond(orbit, setpoints, tick)
    for effect in effects:
        orbit = effect.disturb(orbit, tick)
    for effect in effects:
        orbit = effect.sense(orbit, tick)
    return orbit
