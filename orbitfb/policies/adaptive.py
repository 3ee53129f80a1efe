"""The law that learns while it acts: the response tracked at every tick, a cautious gain of it.

Reading and change of every tick go into the Kalman filter of orbit and response
(`orbitfb.estimation.recursive.estimate`), and the change is a cautious gain on the filtered orbit
and the creep that is expected, less what the currents held since then are worth
(`orbitfb.estimation.recursive.caution`):

    a = −K (x̂ + b̂) − G D h.

The tick waits for none of the learning. `act` only filters the reading; what was read and what was
sent are taken in by `inform`, after the write, and there the gain is made anew when the readings
call for it. What is known of R outlives the state: a loop that closes again begins with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Mask, Vector
from orbitfb.estimation.columns import KnownRf
from orbitfb.estimation.recursive.caution import CautiousGain
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.infill import Infill
from orbitfb.policies.inverse import checked_covariance, checked_response, content_hash, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of R, and the gain made of it; nobody changes it.

    Args:
        response: R̂, shape (n, m) [m/A].
        covariances: Of a row of UᵀR in every group of modes, each of shape (m, m) [(m/A)²]; None:
            those of the settings.
        column: RF column, shape (n,) [m/Hz], with which each covariance has one row and one column
            more; None: as the policy was told.
        chi2: Mean squared normalised innovation of late [1].
    """

    response: Vector
    covariances: tuple[Vector, ...] | None
    column: Vector | None = None
    chi2: float = 1.0


_LOOKED_BACK = 50.0
"""Ticks over which it is asked how well readings are explained [ticks]: with 180 BPMs noise moves
their mean χ² by 1 % then."""


_SAFE = 200
"""Ticks after which what was learnt is kept through a trip [ticks]. By hand: four times the longest
fault of `benchmarks.odd_answers --policy adaptive`, 50 ticks, after which no loop was lost."""


class Track:
    """The running filter of one loop.

    Args:
        known: What is known at first.
        settings: Of the law.
        rf: What is told of the RF; None: it does not step.

    Attributes:
        chi2: Mean squared normalised innovation of late; 1 where what is known of R, with its
            doubt, explains the readings.
    """

    def __init__(self, known: Known, settings: AdaptiveSettings, rf: KnownRf | None = None) -> None:
        if rf is not None and known.column is not None:
            rf = replace(rf, response=known.column)
        self.estimate = RecursiveResponse(known.response, settings.tracking, known.covariances, rf)
        self.gain = CautiousGain(self.estimate, settings.caution)
        self.chi2 = known.chi2

    def change(self, reading: Vector) -> Vector:
        """Give the change for a reading, shape (n,) [m]: shape (m,) [A]. Nothing is taken in."""
        filtered = self.estimate.filtered(reading)
        far = filtered.deviation > self.gain.far_from_floor
        gain = self.gain.far_modes if far else self.gain.near_modes
        return -(gain @ filtered.expected + self.gain.back)

    def learn(self, reading: Vector, applied: Vector, hertz: float = 0.0) -> bool:
        """Take in a reading, shape (n,) [m], and the change that answered it, shape (m,) [A].

        Args:
            reading: The orbit.
            applied: The change.
            hertz: The step of the RF that went with it [Hz].

        Returns:
            Whether there is a new gain.
        """
        said = self.estimate.read(reading)
        if not said.kick:
            self.chi2 += (said.chi2 - self.chi2) / _LOOKED_BACK
        renewed = self.gain.follow_in_turn(said)
        self.estimate.predict(applied, hertz)
        self.gain.hold(applied)
        return renewed

    def at_rest(self) -> Vector:
        """Give the gain on a raw reading that stands still, shape (m, n) [A/m].

        The filter of a steady reading e settles at x̂ = (I − (I − L)(I − R̂K))⁻¹ L e.
        """
        estimate = self.estimate
        floor = estimate.floor
        gains = floor / (floor + estimate.settings.reading_noise**2)
        unit = np.eye(len(gains))
        near = self.gain.near_modes
        left = unit - estimate.rows.T @ near
        settled = np.linalg.solve(unit - (1.0 - gains)[:, None] * left, np.diag(gains))
        return near @ settled @ estimate.modes.T


class AdaptivePolicy:
    """Track the response while the loop runs, and correct with what is known of it.

    Masked BPMs read what the valid ones let expect beside what the filter expects of all.

    Args:
        response: R to begin with, shape (n, m) [m/A].
        settings: What is known beforehand, and how the gain is made.
        covariances: Of a row of UᵀR in every group of modes, strongest first, each of shape
            (m, m) [(m/A)²]; None: those of the settings.
        policy_id: Its name; by default `adaptive-` and a hash of what it begins with.

    Attributes:
        settings: As given.
        learns: That what it knows changes while it acts.
        known: What was known of R when the gain was last made; replaced as a whole.
        rf: What is known of the RF, which it tracks beside R if the settings say so; None: the RF
            does not step.

    Raises:
        RingError: A matrix is not finite or has the wrong shape.
    """

    learns = True

    def __init__(
        self,
        response: Vector,
        settings: AdaptiveSettings,
        covariances: Sequence[Vector] | None = None,
        policy_id: str | None = None,
    ) -> None:
        matrix = checked_response(response)
        parts = None
        if covariances is not None:
            parts = tuple(checked_covariance(part, matrix.shape[1]) for part in covariances)
        self.settings = settings
        self._policy_id = policy_id or "adaptive-" + content_hash(settings, matrix, *(parts or ()))
        self.known = Known(matrix, parts)
        self._kept, self._age = (self.known, self.known), 0
        self.rf: KnownRf | None = None
        self._infill = Infill(matrix)
        self._rest: tuple[Known, Vector] | None = None

    @property
    def policy_id(self) -> str:
        """Name under which the store and every record know it; learning does not change it."""
        return self._policy_id

    @property
    def chi2(self) -> float:
        """Mean squared normalised innovation of late: 1 while it explains what it reads [1]."""
        return self.known.chi2

    @property
    def response(self) -> Vector:
        """R̂ as known, shape (n, m) [m/A]."""
        return self.known.response

    @property
    def covariances(self) -> tuple[Vector, ...] | None:
        """Covariance of a row of UᵀR̂ in every group, as known; None: those of the settings."""
        known = self.known.covariances
        size = self.response.shape[1]
        return None if known is None else tuple(part[:size, :size] for part in known)

    @property
    def _tracked(self) -> KnownRf | None:
        return self.rf if self.settings.track_rf else None

    @property
    def learns_rf(self) -> bool:
        """Whether it wants to know of steps of the RF."""
        return self._tracked is not None

    @property
    def gain_matrix(self) -> Vector:
        """Gain on a raw reading at rest, shape (m, n) [A/m]."""
        known = self.known
        if self._rest is None or self._rest[0] is not known:
            self._rest = known, frozen(Track(known, self.settings, self._tracked).at_rest())
        return self._rest[1]

    def initial_state(self) -> Track:
        """Begin with what is known of R by now, and nothing known of the orbit."""
        return Track(self.known, self.settings, self._tracked)

    def changes(self, errors: Vector) -> Vector:
        """Refuse: a decision depends on what was learnt.

        Raises:
            ConfigError: Always.
        """
        raise ConfigError("an adaptive policy decides by earlier orbits, so not on many at once")

    def act(self, error: Vector, valid: Mask, state: Track) -> tuple[Vector, Track]:
        """Decide.

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).
            state: The running filter; it is left as it is.

        Returns:
            The change of setpoints, shape (m,) [A], and the filter.
        """
        change = state.change(self._filled(error, valid, state))
        return (change if valid.all() else self._infill.least(change, valid)), state

    def inform(
        self, error: Vector, valid: Mask, applied: Vector, state: Track, hertz: float = 0.0
    ) -> Track:
        """Take in what was read and what was sent.

        Args:
            error: Orbit − reference, shape (n,) [m], as `act` had it.
            valid: BPMs that count, shape (n,).
            applied: Change of setpoints as it was sent, shape (m,) [A].
            state: The running filter; it learns.
            hertz: Step of the RF that went with it [Hz].

        Returns:
            The filter.
        """
        self._age += 1
        if self._age >= _SAFE:
            self._kept, self._age = (self._kept[1], self.known), 0
        if state.learn(self._filled(error, valid, state), applied, hertz):
            its = state.estimate
            self.known = Known(frozen(its.response), its.whole_covariances, its.column, state.chi2)
        return state

    def take_back(self) -> None:
        """Know what was known some hundred ticks ago: the loop has tripped.

        A ring that answers oddly for a second teaches a response that is not its own, and it is
        with that one that the loop tripped.
        """
        self.known = self._kept[0]
        self._kept, self._age = (self.known, self.known), 0

    def _filled(self, error: Vector, valid: Mask, state: Track) -> Vector:
        if np.count_nonzero(valid) == len(valid):
            return error
        orbit = state.estimate.orbit
        return orbit + self._infill.fill(error - orbit, valid)
