"""Synthetic measured responses with known truth, of a part of the default ring."""

from dataclasses import dataclass

import numpy as np

from orbitfb.loco.measured import Measured
from orbitfb.loco.optics import RingOptics
from orbitfb.physics.places import Ring

NOISE = 2e-6 / 100e-6
"""2 µm at 100 µrad [m/rad]."""


@dataclass
class Truth:
    ring: Ring
    measured: Measured
    gain: dict[str, np.ndarray]
    kick: dict[str, np.ndarray]
    gradient: np.ndarray


def devices(ring: Ring, every: int = 4) -> Measured:
    """A measurement without numbers; the planes have other correctors."""
    bpms, correctors = ring.places("BPM")[::every], ring.places("COR")[::every]
    at = {"x": bpms, "y": bpms}
    by = {"x": correctors, "y": correctors[:-3]}
    nothing = {(p, q): np.full((len(at[p]), len(by[q])), np.nan) for p in "xy" for q in "xy"}
    return Measured(at, by, dict(nothing), dict(nothing))


def synthetic(
    seed: int = 1,
    gains: float = 0.02,
    gradients: float = 0.001,
    faults: dict[tuple[str, str, int], float] | None = None,
    noise: float = NOISE,
    known: bool = False,
    every: int = 4,
) -> Truth:
    """Draw a response of a healthy ring, with faults (group, plane, device): factor."""
    ring, rng = Ring.load(), np.random.default_rng(seed)
    empty = devices(ring, every)
    optics = RingOptics(ring, empty)
    gradient = gradients * rng.standard_normal(len(optics.quadrupoles))
    gain = {p: 1 + gains * rng.standard_normal(len(empty.bpms[p])) for p in "xy"}
    kick = {p: 1 + gains * rng.standard_normal(len(empty.correctors[p])) for p in "xy"}
    for (group, plane, device), factor in (faults or {}).items():
        if group == "gradient":
            gradient[device] += factor
        else:
            {"gain": gain, "kick": kick}[group][plane][device] *= factor
    its = optics.at(gradient)
    response, sigma = {}, {}
    for p in "xy":
        clean = gain[p][:, None] * its[p].own * kick[p]
        response[p, p] = clean + noise * rng.standard_normal(clean.shape)
        sigma[p, p] = np.full(clean.shape, noise if known else np.nan)
    return Truth(
        ring, Measured(empty.bpms, empty.correctors, response, sigma), gain, kick, gradient
    )
