"""Drift of the response from one machine state to another."""

from collections.abc import Mapping
from typing import Any, Literal, cast

import numpy as np
from pydantic import Field, model_validator

from orbitfb.core.settings import Settings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.response import response, seeded_gradient_errors

Preset = Literal["none", "paper", "mild", "strong"]

PRESETS: Mapping[Preset, Mapping[str, float]] = {
    "none": {"ticks": 0},
    "paper": {"ticks": 10_000, "beta_beat": 0.07},
    "mild": {
        "ticks": 10_000,
        "beta_beat": 0.03,
        "bpm_gain_rms": 0.01,
        "corrector_gain_rms": 0.01,
    },
    "strong": {
        "ticks": 10_000,
        "beta_beat": 0.05,
        "bpm_gain_rms": 0.03,
        "corrector_gain_rms": 0.03,
        # 0.06 m/rad per entry at the default ring's mean calibration of 5e-5 rad/A: spectral norm
        # 4 times the smallest singular value, so that the weakest modes change their sign
        "matrix_noise": 3.0e-6,
    },
}
"""Values of the keys under a preset; a key that is given explicitly wins."""


class DriftSettings(Settings):
    """How the response drifts: R_t = R1 + (R2 − R1) · min(1, t / ticks)."""

    preset: Preset = Field(
        default="none",
        description="Named drift that gives the other keys their values: none; paper (7 % "
        "beta-beat); mild (3 %, gains 1 %); strong (5 %, gains 3 %, ill-conditioned).",
    )
    ticks: int = Field(default=0, ge=0, description="Length of the drift [ticks]; 0: no drift.")
    beta_beat: float = Field(
        default=0.07, ge=0, le=0.3, description="Rms of Δβ_x/β_x of R2 at the BPMs (a ratio)."
    )
    bpm_gain_rms: float = Field(
        default=0.0, ge=0, le=0.5, description="Rms of the gain errors of the BPMs in R2 (a ratio)."
    )
    corrector_gain_rms: float = Field(
        default=0.0,
        ge=0,
        le=0.5,
        description="Rms of the gain errors of the correctors in R2 (a ratio).",
    )
    matrix_noise: float = Field(
        default=0.0,
        ge=0,
        description="Rms of independent errors on every entry of R1 and of R2 [m/A]: neither is "
        "then what the optics say, and both are ill-conditioned.",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: Any) -> Any:
        if not isinstance(given, Mapping):
            return given
        keys = cast(Mapping[str, Any], given)
        # An unknown preset is left for the field itself to refuse.
        values = PRESETS.get(keys.get("preset", "none"), {})
        return {**values, **keys}


class Drift(Effect):
    """The response moves linearly from R1 to R2, then stays.

    R2 = diag(1 + BPM gains) · R(gradient errors) · diag(1 + corrector gains). With matrix noise,
    R1 and R2 carry independent errors of their entries.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: What drifts, and how far.
        rng: Random numbers of this effect.
    """

    def __init__(
        self, ring: Ring, planes: Planes, settings: DriftSettings, rng: np.random.Generator
    ) -> None:
        nominal = response(ring, planes)
        start, end = drift_pair(ring, planes, settings, rng)
        self._start_change: Matrix = start - nominal
        self._drift: Matrix = end - start
        self._noisy = settings.matrix_noise > 0
        self._ticks = settings.ticks

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        """Add what R_t makes of the currents beyond the nominal response."""
        progress = min(1.0, tick / self._ticks) if self._ticks else 0.0
        moved = orbit + self._drift @ (progress * currents)
        return moved + self._start_change @ currents if self._noisy else moved


def drift_pair(
    ring: Ring, planes: Planes, settings: DriftSettings, rng: np.random.Generator
) -> tuple[Matrix, Matrix]:
    """Draw the response at the beginning and at the end of a drift.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: What drifts, and how far.
        rng: Random numbers of the errors.

    Returns:
        R1 and R2, each of shape (n, m) [m/A].
    """
    nominal = response(ring, planes)
    seed = int(rng.integers(2**32))
    optics = nominal
    if settings.beta_beat > 0:
        errors = seeded_gradient_errors(ring, settings.beta_beat, seed)
        optics = response(ring, planes, errors)
    bpm_gain = 1 + settings.bpm_gain_rms * _normal(rng, len(nominal))
    corrector_gain = 1 + settings.corrector_gain_rms * _normal(rng, nominal.shape[1])
    drifted: Matrix = bpm_gain[:, None] * optics * corrector_gain
    # Planes stay uncoupled: only the entries that the optics fill are uncertain.
    noise = settings.matrix_noise * (nominal != 0)
    start: Matrix = nominal + noise * _normal(rng, *nominal.shape)
    return start, drifted + noise * _normal(rng, *nominal.shape)


def _normal(rng: np.random.Generator, *shape: int) -> Matrix:
    return rng.standard_normal(shape)
