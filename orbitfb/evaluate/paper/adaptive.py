"""Adaptive controllers: R̂ tracked tick by tick, a cautious gain, swapped when readings call for it.

What they know beforehand is what a physicist knows: the noise of the readings, the motion of the
ground, how wrong the first R is, and how far it drifts (`knowledge`). All else is the same in
every scenario.

- `adaptive_linear`: the gain acts on the filtered orbit (and on the creep that is expected);
- `model_based_rl`: so does the paper's 3 × 512 network, which holds the gain at the floor and the
  one far from it at once. Its hidden layers are embedded once; a swap renews the last matrix;
- `memoryless`: the network acts on the raw reading, and averages its noise by a small slope at
  zero. Only the estimate of R has a memory.

Every part can be left out by an option, to see what it is worth (`ablation`).
"""

from typing import Literal

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Vector
from orbitfb.estimation.recursive.caution import CautiousGain
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.estimation.recursive.settings import CautionSettings, RecursiveSettings
from orbitfb.evaluate.paper.environment import Environment
from orbitfb.evaluate.paper.scenarios import Scenario
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.two_scale import TwoScaleNetwork

_SMALLEST_ERROR = 1e-5
_CREEP_TO_GROUND = 0.5


class AdaptiveSettings(Settings):
    """What a controller is made of; the defaults are the method, the rest is for comparison."""

    form: Literal["linear", "network"] = Field(
        default="network", description="What the law is written as."
    )
    filtered: bool = Field(
        default=True, description="Whether it acts on the filtered orbit, or on the raw reading."
    )
    noise_model: bool = Field(
        default=True, description="Whether R̂ is told apart from noise; without: naive regression."
    )
    prior: bool = Field(
        default=True, description="Whether the error of the first R counts; without: unknown."
    )
    caution: bool = Field(
        default=True, description="Whether doubt about R damps the gain; without: plain λ."
    )
    regularisation: float = Field(
        default=0.1, ge=0.0, description="λ when there is no caution [m/rad]."
    )
    events: bool = Field(
        default=True, description="Whether a gain is swapped when readings call for it."
    )
    drift: bool = Field(default=True, description="Whether R is taken to drift.")
    creep: bool = Field(
        default=True, description="Whether the creep of the orbit by the drift is estimated."
    )
    near_far: bool = Field(
        default=True, description="Whether the gain at the floor differs from that far from it."
    )
    dither: float = Field(
        default=0.0, ge=0.0, description="Orbit that random changes are to make, rms [m]."
    )
    noise_factor: float = Field(
        default=1.0, gt=0.0, description="Assumed noise over the true one [1]."
    )
    error_factor: float = Field(
        default=1.0, gt=0.0, description="Assumed error of the first R over the true one [1]."
    )
    drift_factor: float = Field(
        default=1.0, gt=0.0, description="Assumed drift over the true one [1]."
    )
    ground_factor: float = Field(
        default=1.0, gt=0.0, description="Assumed ground motion over the true one [1]."
    )


class Adaptive:
    """A controller of its own for each trajectory.

    Args:
        environment: The trajectories.
        settings: What it is made of.
    """

    def __init__(self, environment: Environment, settings: AdaptiveSettings) -> None:
        scenario = environment.scenario
        self.loops = [Loop(scenario, number, settings) for number in environment.trajectories]

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        return np.array([loop.act(row) for loop, row in zip(self.loops, observed, strict=True)])


def adaptive_linear(environment: Environment, **options: object) -> Adaptive:
    """Make the linear form; options as in `AdaptiveSettings`."""
    return Adaptive(environment, AdaptiveSettings.model_validate({"form": "linear", **options}))


def model_based_rl(environment: Environment, **options: object) -> Adaptive:
    """Make the network on the filtered orbit; options as in `AdaptiveSettings`."""
    return Adaptive(environment, AdaptiveSettings.model_validate(options))


def memoryless(environment: Environment, **options: object) -> Adaptive:
    """Make the network on the raw reading; options as in `AdaptiveSettings`."""
    return Adaptive(environment, AdaptiveSettings.model_validate({"filtered": False, **options}))


class Loop:
    """The controller of one trajectory.

    Args:
        scenario: What happens; the controller looks at nothing of it but what may be known.
        trajectory: Number of the trajectory.
        settings: What it is made of.

    Attributes:
        estimate: The running estimate of R.
        gain: The gains made of it.
    """

    def __init__(self, scenario: Scenario, trajectory: int, settings: AdaptiveSettings) -> None:
        first = scenario.known(trajectory)
        self._settings = settings
        self.estimate = RecursiveResponse(first, knowledge(scenario, settings))
        self.gain = CautiousGain(self.estimate, _caution(settings))
        self._change: Vector | None = None
        self._slopes = _slopes(self.estimate, settings)
        self._network: NetworkPolicy | None = None
        if settings.form == "network":
            noise = 0.0 if settings.filtered else scenario.reading_noise**2
            thresholds = self.gain.far_from_floor * np.sqrt(self.estimate.floor + noise)
            self._scales = TwoScaleNetwork(first, self.estimate.modes, thresholds)
            self._network = self._embed()
        self._dither = np.random.default_rng([scenario.seed, trajectory, 99])

    def act(self, reading: Vector) -> Vector:
        """Give the change, shape (m,) [rad], for a reading, shape (n,) [m]."""
        settings, estimate = self._settings, self.estimate
        if self._change is not None:
            estimate.predict(self._change)
        innovation = estimate.read(reading)
        swapped = self.gain.follow(innovation, both=self._network is not None)
        orbit = estimate.expected if settings.filtered else reading
        if self._network is not None:
            if swapped:
                self._network = self._embed()
            self._change = self._network.changes(orbit)
        elif self.gain.is_far and settings.near_far:
            self._change = -(self.gain.far @ orbit)
        else:
            self._change = -(self._near() @ orbit)
        if settings.dither:
            drawn = self._dither.standard_normal(len(reading))
            self._change = self._change + settings.dither * (self.gain.near @ drawn)
        return self._change

    def _near(self) -> Vector:
        near = self.gain.near if self._settings.near_far else self.gain.far
        if self._slopes is None:
            return near
        modes = self.estimate.modes
        return (near @ modes * self._slopes) @ modes.T

    def _embed(self) -> NetworkPolicy:
        return self._scales.policy(self._near(), self.gain.far, self.estimate.response, "adaptive")


def knowledge(scenario: Scenario, settings: AdaptiveSettings) -> RecursiveSettings:
    """Say what the controller is told beforehand.

    Args:
        scenario: What happens.
        settings: What of it is left out or wrong.
    """
    ground = 0.0 if scenario.walk is None else float(np.linalg.norm(scenario.walk))
    ground *= settings.ground_factor / np.sqrt(len(scenario.start))
    error = max(scenario.error_entry, _SMALLEST_ERROR) * settings.error_factor
    unknown = float(np.sqrt(np.mean(scenario.start**2)))
    drift = settings.drift * settings.drift_factor / np.sqrt(scenario.steps)
    return RecursiveSettings(
        reading_noise=scenario.reading_noise * settings.noise_factor,
        ground=ground,
        white=scenario.white * settings.ground_factor,
        prior_entry=error if settings.prior else unknown,
        drift_entry=scenario.drift_entry * drift,
        drift_relative=scenario.drift_relative * drift,
        creep=_CREEP_TO_GROUND * ground if settings.creep else 0.0,
        noise_model=settings.noise_model,
    )


def _caution(settings: AdaptiveSettings) -> CautionSettings:
    if settings.caution:
        return CautionSettings(events=settings.events)
    return CautionSettings(
        events=settings.events, caution=0.0, regularisation=settings.regularisation
    )


def _slopes(estimate: RecursiveResponse, settings: AdaptiveSettings) -> Vector | None:
    """Give the slope at zero that a law without a filter needs, shape (n,) [1]."""
    if settings.filtered:
        return None
    floor = estimate.floor
    return floor / (floor + estimate.settings.reading_noise**2)
