"""Motion of the beam that healthy rings have, but not every one.

The floor of a record is a walk and the noise of single readings. Some rings also shake faster than
they are read: vibration and ripple come down on all frequencies alike, and laws that jump to and
fro would be named for them. The ground of some does not walk: it goes on as before, springs back or
drifts, and laws of correctors or of smooth courses would. These are no causes: where one of them
says more than the best cause it joins the floor, and causes that were accepted are told again over
it.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from orbitfb.diagnose.likelihood.ground import shaken_shapes
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.floor import improve
from orbitfb.estimation.moments import Moments
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import FREELY, SURE
from orbitfb.estimation.shapes import fit_shaken, fit_shapes

_TURNS, _ROUNDS = 3, 6
"""Turns in which walk and shaking are fitted one beside the other, and the rounds of each."""
_MORE_FLOORS = 6
"""Times at most that the floor is estimated again once motion has joined it. By hand: walk, noise
and colour are fitted by turns, and of a colour four or five of them raise the density."""
_NEAR = 0.5
"""Share of what it has to have that it must have before it gets a floor of its own: half may be in
the floor, as for a candidate (`own_floors.refitted`)."""
_GLIMPSE = 0.25
"""Share of that which one turn must show before the others are taken: the first has about half of
what all have, or more (`test_healthy_motion` says so of rings that shake)."""


def with_motion(space: Workspace, enough: float) -> Workspace | None:
    """Take motion into the floor that healthy rings may have; None: there is none.

    Args:
        space: Of a round.
        enough: Evidence of the best cause [nats]: motion goes first unless that is surely likelier.
    """
    base = cache(lambda: space.with_floor().log_posterior())
    found = []
    if space.noise.shaken is None:
        found.append(_shaken(space, base, enough))
    if not np.any(space.noise.colour):
        found.append(_coloured(space, base, enough))
    gain, after = max(found, key=lambda one: one[0], default=(0.0, space))
    return _converged(after) if gain > enough - SURE else None


def _converged(space: Workspace) -> Workspace:
    """The same with a floor that has come to its end: what it lacks would speak for a cause."""
    for _ in range(_MORE_FLOORS):
        further = space.with_floor()
        gain = further.log_posterior() - space.log_posterior()
        space = further if gain > 0.0 else space
        if gain < 1.0:
            break
    return space


def _shaken(space: Workspace, base: Callable[[], float], enough: float) -> tuple[float, Workspace]:
    """Motion that is new at every row, and what it is worth [nats].

    It has many shapes, of which some follow chance: by as much as they say more of the frequencies
    that they are fitted to than of others. Each half of them tells it for the other.
    """
    left, scatter = space.unmodelled()
    moments = Moments.of(left, space.transform).beside(scatter)
    soon = _floor(space, moments, True, turns=1)
    if moments.more(soon, space.noise) < _GLIMPSE * _NEAR * enough:
        return 0.0, space
    noise = _floor(space, moments, True)
    if moments.more(noise, _floor(space, moments, False)) < _NEAR * enough:
        return 0.0, space
    after = space.with_noise(noise).with_floor()
    gain = after.log_posterior() - base()
    if gain < enough:
        return gain, after
    chance = 0.0
    halves = Moments.halves(left, space.transform, scatter)
    for one, other in (halves, halves[::-1]):
        found, plain = (_floor(space, one, shaken) for shaken in (True, False))
        chance += one.more(found, plain) - other.more(found, plain)
    return gain - max(0.5 * chance, 0.0), after


def _floor(space: Workspace, moments: Moments, shaken: bool, turns: int = _TURNS) -> StepNoise:
    """Fit a floor to moments, with motion that is new at every row or without."""
    shapes = shaken_shapes(space.signals.record.layout)
    noise, weights, sizes = space.noise, space.weights, None
    for _ in range(turns):
        if shaken:
            noise, sizes = fit_shaken(noise, moments, shapes, sizes, rounds=_ROUNDS)
        noise, weights = fit_shapes(
            noise, moments, space.shapes, space.held, weights, rounds=_ROUNDS
        )
    return improve(noise, moments, noise.walk, FREELY, space.trust)


def _coloured(
    space: Workspace, base: Callable[[], float], enough: float
) -> tuple[float, Workspace]:
    """A ground of another colour than a walk's, and what it is worth [nats]."""
    left, transform = space.left, space.transform
    levels, noise = space.noise.recoloured(left, transform)
    if not np.any(noise.colour):
        return 0.0, space
    root = np.sqrt(levels)
    soon = replace(noise, walk=root[:, None] * noise.walk * root)
    glance = soon.log_likelihood(left, transform) - space.noise.log_likelihood(left, transform)
    if glance < _NEAR * enough:
        return 0.0, space
    weights = space.shapes.scaled(space.weights, levels)
    after = replace(space, weights=weights).with_noise(noise).with_floor()
    return after.log_posterior() - base() - after.noise.choice_of_colour(transform), after
