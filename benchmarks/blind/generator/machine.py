"""The closed loop, and the replay of its actions: one tick after the other, in plain numpy."""

import itertools
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.generator.conditions import Conditions, tikhonov
from benchmarks.blind.generator.rings import Array


class Nature:
    """An effect as nature makes it; this one does nothing.

    The hooks by tick are called from the onset on only, in order, once per tick; memory begins in
    a steady state with the first call. The hooks for a whole record give rows for every tick;
    those before the onset are not used.
    """

    start = 0
    """Its first row; set before `bind`."""

    def bind(self, case: Conditions, rng: np.random.Generator) -> None:
        """Take what it needs of the case; its random numbers do not depend on its size."""

    def currents(self, row: int, wanted: Array) -> Array:
        """Currents in force at the reading of this row, from the setpoints sent, both (m,) [A]."""
        return wanted

    def bend(self, row: int, orbit: Array, currents: Array) -> Array:
        """Orbit after what depends on it, (n,) [m]."""
        return orbit

    def extra_errors(self) -> list[tuple[int, Array]]:
        """Further gradient errors (q,) [1/m] at rows after the onset, on straight lines between.

        There are none before the first row; after the last they stay.
        """
        return []

    def motion(self) -> Array | None:
        """Orbit that is added whatever the loop does, (rows, n) [m]."""
        return None

    def noise(self, noise: Array) -> Array:
        """Reading noise of all rows, (rows, n) [m]."""
        return noise

    def read(self, row: int, seen: Array) -> Array:
        """What is told of what is seen (with its noise), both (n,) [m]."""
        return seen


@dataclass(frozen=True)
class Response:
    """The response (n, m) [m/A] from a row on, and what it gains per row; None: it stays."""

    row: int
    start: Array
    growth: Array | None = None


@dataclass(eq=False)
class Log:
    """What a run leaves: rows of the record only, and the state of the loop at every row."""

    readings: Array
    setpoints: Array
    actions: Array
    sent: Array
    rows: int


def run(
    case: Conditions,
    effects: list[tuple[int, Nature]],
    seed: int,
    replay: Array | None = None,
    limit: float = 1.5e-3,
    number: int = 0,
) -> Log:
    """Let the machine run.

    Args:
        case: Circumstances.
        effects: Each with its first row (of the warm-up too).
        seed: Of every random number but those of the circumstances.
        replay: Setpoints of every row (rows, m) [A]: no loop, these are in force.
        limit: An orbit of this size stops the run [m], as an interlock would.
        number: Of the first of the effects among those of the case: each has its own luck,
            whatever else is there.
    """
    streams = np.random.SeedSequence(seed).spawn(1 + number + len(effects))
    noise = np.random.default_rng(streams[0]).standard_normal((case.rows, len(case.bpm_names)))
    noise *= case.noise
    for (start, effect), stream in zip(effects, streams[1 + number :], strict=True):
        effect.start = start
        effect.bind(case, np.random.default_rng(stream))
        noise[start:] = effect.noise(noise)[start:]
    responses, ground = _optics(case, effects)
    for start, effect in effects:
        motion = effect.motion()
        if motion is not None:
            ground[start:] += motion[start:]
    return _ticks(case, effects, noise, responses, ground, replay, limit)


def _optics(case: Conditions, effects: list[tuple[int, Nature]]) -> tuple[list[Response], Array]:
    """Responses, and the orbit of the quadrupoles that go with them."""
    knots = [
        [(max(start, row), errors) for row, errors in effect.extra_errors()]
        for start, effect in effects
    ]
    rows = sorted({row for its in knots for row, _ in its if row < case.rows})
    responses, ground = [Response(0, case.true_response())], case.moved_at_bpms()
    for begin, end in itertools.pairwise([*rows, case.rows]):
        first, last = (
            sum((_errors(its, begin, row) for its in knots if its), np.zeros(1))
            for row in (begin, end)
        )
        response, within = case.true_response(first), slice(begin, end)
        ground[within] = case.moved_at_bpms(first, within)
        if np.array_equal(first, last):
            responses.append(Response(begin, response))
            continue
        growth = (case.true_response(last) - response) / (end - begin)
        responses.append(Response(begin, response, growth))
        share = (np.arange(end - begin) / (end - begin))[:, None]
        ground[within] += share * (case.moved_at_bpms(last, within) - ground[within])
    return responses, ground


def _errors(knots: list[tuple[int, Array]], begin: int, row: int) -> Array:
    """Errors of an effect at a row of the piece that begins at another one, (q,)."""
    before = [knot for knot in knots if knot[0] <= begin]
    if not before:
        return np.zeros_like(knots[0][1])
    (first, errors), after = before[-1], knots[len(before) :]
    if not after:
        return errors
    last, there = after[0]
    return errors + (row - first) / (last - first) * (there - errors)


def _ticks(
    case: Conditions,
    effects: list[tuple[int, Nature]],
    noise: Array,
    responses: list[Response],
    ground: Array,
    replay: Array | None,
    limit: float,
) -> Log:
    n, m = len(case.bpm_names), len(case.corr_names)
    readings, actions = np.zeros((case.rows, n)), np.zeros((case.rows, m))
    setpoints = np.zeros((case.rows, m))
    controller, bpm_scale = -case.gain * case.controller, 1 + case.bpm_gains
    corrector_scale = 1 + case.corrector_gains
    moves = np.diff(case.dither, axis=0, append=0 * case.dither[:1])
    moves[-1] = 0
    wanted = _start(case, ground[0])
    switch, response = 0, responses[0].start
    rows = case.rows
    for row in range(case.rows):
        if replay is not None:
            wanted = replay[row]
        while switch + 1 < len(responses) and responses[switch + 1].row <= row:
            switch += 1
            response = responses[switch].start
        its = responses[switch]
        if its.growth is not None:
            response = its.start + (row - its.row) * its.growth
        in_force = wanted
        for start, effect in effects:
            if row >= start:
                in_force = effect.currents(row, in_force)
        in_force = in_force * corrector_scale
        orbit = response @ in_force + ground[row]
        for start, effect in effects:
            if row >= start:
                orbit = effect.bend(row, orbit, in_force)
        seen = bpm_scale * orbit + noise[row]
        for start, effect in effects:
            if row >= start:
                seen = effect.read(row, seen)
        readings[row], setpoints[row] = seen, wanted
        if replay is None:
            action = controller @ (seen - case.reference[row]) + moves[row]
            actions[row] = action
            wanted = wanted + action
            if row > case.warm and np.max(np.abs(orbit)) > limit:
                rows = row + 1
                break
    return Log(
        readings=readings[case.warm : rows],
        setpoints=setpoints[case.warm : rows],
        actions=actions[case.warm : rows],
        sent=setpoints[:rows],
        rows=rows,
    )


def _start(case: Conditions, orbit: Array) -> Array:
    """Setpoints of a loop that has run for long."""
    wanted = np.zeros(len(case.corr_names))
    inverse = tikhonov(case.model, case.regularisation / 5)
    response = case.true_response() * (1 + case.corrector_gains)
    for _ in range(30):
        left = (1 + case.bpm_gains) * (orbit + response @ wanted) - case.reference[0]
        wanted = wanted - inverse @ left
    return wanted
