"""Track the response matrix at every tick, while the loop runs: Bayesian and unbiased.

With the orbit x, the change a and the reading y of a mode, of which R_i is the row of UᵀR,

    x_{n+1} = x_n + R_i a_n + b + w_n,     y_n = x_n + v_n,

x and the coefficients θ = (R_i, b) are one Gaussian state. Its Kalman filter needs, of every
group of modes that share their noise, the covariance P of θ, the vector c = cov(θ, x) and the
number p = var(x). With the regressor u = (a, 1) a tick is

    p ← p + uᵀ(2c + P u) + q,   c ← c + P u,   x̂ ← x̂ + θ̂ᵀ u          (prediction)
    S = p + r²,   ν = y − x̂,
    θ̂ ← θ̂ + c ν / S,   P ← P − c cᵀ / S,   x̂ ← x̂ + p ν / S,   (c, p) ← (c, p) r² / S.

With c = P φ this is the recursive regression of innovations on prefiltered changes φ, with the
filter that the knowledge of x calls for at every tick. The reading noise that a feedback writes
into its change and into the next difference of readings does not bias it, as it does the naive
regression. Between ticks R walks at random: P ← P + Q.

b is the creep that a drift of R makes of setpoints that stay. x̂ has in every mode the gain of
that mode's own noise; only P is shared within a group. How P and θ̂ are kept is told in
`orbitfb.estimation.recursive.coefficients`.

A reading that nothing explains is a kick of the orbit: x is forgotten, R is not. Several in a row
say that R is not what it was, and its covariance is widened.

Source: the Kalman filter of the augmented state, e.g. Ljung and Söderström, Theory and Practice
of Recursive Identification (1983), ch. 3.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import Columns, KnownRf
from orbitfb.estimation.recursive.coefficients import Coefficients
from orbitfb.estimation.recursive.group import make_groups, step_variances
from orbitfb.estimation.recursive.said import Filtered, Innovation
from orbitfb.estimation.recursive.settings import RecursiveSettings

_DIFFUSE = 1e8
"""Variance of an orbit of which nothing is known, over that of the reading noise."""
_KICKS = 2.0
_KICK_FADES = 0.1
_WIDENING = 4.0
_WIDEST = 4.0**4
"""Variance that readings which nothing explains may give R, over that of the beginning: where they
never end, not R but the noise is another one."""


class RecursiveResponse:
    """The running estimate of R and of the orbit.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A, or m/rad where changes are kicks].
        settings: Noise, prior and drift, in the same units.
        covariances: Covariance of a row of UᵀR in every group, each of shape (m, m), or of
            (m + 1, m + 1) with the RF column; None: that of the settings.
        rf: What is known of the RF, one more column of R; None: it does not step.

    Attributes:
        modes: U, the left singular vectors of the first R̂, shape (n, n).
        groups: The modes of every group, strongest first.
        settings: As given.

    Raises:
        EstimationError: The response is not a finite matrix that is not zero.
    """

    def __init__(
        self,
        response: Vector,
        settings: RecursiveSettings,
        covariances: Sequence[Vector] | None = None,
        rf: KnownRf | None = None,
    ) -> None:
        self._columns = columns = Columns(response, rf)
        self.settings = settings
        n, self._size = response.shape
        self.modes, whole = np.linalg.svd(response)[0], columns.whole(response)
        rows = self.modes.T @ whole
        self._noise = settings.reading_noise**2
        self._steps = step_variances(rows[:, : self._size], settings)
        groups, drift = make_groups(rows, columns, whole, self._steps, settings)
        for group, covariance in zip(groups, covariances or (), strict=False):
            known = slice(min(len(covariance), columns.actuators))
            group.covariance[known, known] = covariance[known, known]
        self.groups = [group.members for group in groups]
        self._coefficients = Coefficients(groups, drift)
        self._widest = _WIDEST * self._coefficients.traces()
        self._regressor = np.ones(len(drift))
        self._orbit = np.zeros(n)
        count, sizes = len(groups), [group.size for group in groups]
        self._weights, self._group_of = np.array(sizes) / n, np.repeat(np.arange(count), sizes)
        # p if R were known, of every mode and of every group; and p of every group
        steps = [group.step for group in groups]
        self._all_steps = np.array([*self._steps, *steps, *steps])
        self._variances = np.zeros(len(self._all_steps))
        parts = np.split(self._variances, [n, n + count])
        self._known, self._group_known, self._group_variances = parts
        self._since_drift = 0
        self._kicks = 0.0
        self.reset()

    @property
    def rows(self) -> Vector:
        """Rows of UᵀR̂ as columns, shape (m, n)."""
        return self._coefficients.rows()[:, : self._size].T

    @property
    def response(self) -> Vector:
        """R̂ as it stands, shape (n, m)."""
        return self.modes @ self.rows.T

    @property
    def creep(self) -> Vector:
        """The creep b̂ in every mode, shape (n,) [m/tick]."""
        if self.settings.creep == 0.0:
            return np.zeros(len(self._orbit))
        return self._coefficients.column(-1)

    @property
    def column(self) -> Vector | None:
        """The RF column as it stands, shape (n,) [m/Hz]; None: the RF does not step."""
        if self._columns.rf is None:
            return None
        return self.modes @ self._coefficients.column(self._size) / self._columns.unit

    @property
    def orbit(self) -> Vector:
        """The filtered orbit x̂, shape (n,) [m]."""
        return self.modes @ self._orbit

    @property
    def covariances(self) -> tuple[Vector, ...]:
        """Covariance of a row of UᵀR in every group, copied, each of shape (m, m)."""
        return self._covariances(self._size)

    @property
    def whole_covariances(self) -> tuple[Vector, ...]:
        """The same with the RF column behind the correctors, if it is one."""
        return self._covariances(self._columns.actuators)

    @property
    def expected(self) -> Vector:
        """The orbit at the next tick if nothing is changed, x̂ + b̂, shape (n,) [m]."""
        return self.modes @ (self._orbit + self.creep)

    @property
    def deviation(self) -> float:
        """Norm of x̂ over what noise alone makes expect of the orbit at the next tick [1]."""
        return float(np.sqrt(self._orbit @ self._orbit / np.sum(self._known + self._steps)))

    @property
    def floor(self) -> Vector:
        """Variance of the predicted orbit of every mode at rest, if R is known, (n,) [m²]."""
        ratio = self._steps / self._noise
        return 0.5 * self._noise * (ratio + np.sqrt(ratio * (ratio + 4.0)))

    @property
    def covariance(self) -> Vector:
        """Covariance of a row of R̂, mean over the rows, shape (m, m)."""
        return self.weighted_covariance(np.full(len(self._orbit), 1.0 / len(self._orbit)))

    def weighted_covariance(self, weights: Vector) -> Vector:
        """Sum the covariances of all rows of UᵀR̂ with weights of the rows, shape (m, m)."""
        total = np.zeros((self._size, self._size))
        for members, covariance in zip(self.groups, self.covariances, strict=True):
            total += float(np.sum(weights[members])) * covariance
        return total

    def weakest_covariance(self) -> Vector:
        """Give the covariance of a row of the weakest modes, shape (m, m)."""
        return self.covariances[-1]

    def normalised_errors(self, response: Vector) -> Vector:
        """Errors against a known response in units of the stated uncertainty.

        Args:
            response: The true R, shape (n, m).

        Returns:
            Shape (n, m), by mode and by principal direction of the covariance of its group;
            independent standard normal numbers when the stated uncertainty is right.
        """
        error = self.rows.T - self.modes.T @ response
        for members, covariance in zip(self.groups, self.covariances, strict=True):
            values, directions = np.linalg.eigh(covariance)
            error[members] = (error[members] @ directions) / np.sqrt(values)
        return error

    def reset(self) -> None:
        """Forget the orbit, not R: before the first reading, after a gap or a kick."""
        self._forget_orbit(_DIFFUSE * self._noise)

    def predict(self, change: Vector, hertz: float = 0.0) -> None:
        """Take in the change, shape (m,), that was made after the last reading.

        Args:
            change: Of the setpoints.
            hertz: The step of the RF that went with it [Hz].
        """
        self._regressor[: self._size] = change
        if self._columns.rf is not None:
            self._regressor[self._size] = hertz / self._columns.unit
        self._since_drift += 1
        if self._since_drift >= self.settings.drift_every:
            self._add_drift()
        moved, added = self._coefficients.predict(self._regressor)
        self._orbit += moved
        self._variances += self._all_steps
        self._group_variances += added

    def filtered(self, reading: Vector) -> Filtered:
        """Say where a reading, shape (n,) [m], puts the orbit; nothing is taken in."""
        noise, predicted = self._noise, self._known + self._extra()[self._group_of]
        innovations, worth, chi2 = self._weigh(reading, predicted)
        if chi2 > self.settings.kick_chi2:
            orbit = self._orbit + innovations
            known = np.full(len(orbit), noise)
        else:
            orbit = self._orbit + predicted * worth
            known = self._known * (noise / (self._known + noise))
        usual = float(np.sum(known + self._steps))
        return Filtered(orbit + self.creep, float(np.sqrt(orbit @ orbit / usual)))

    def read(self, reading: Vector) -> Innovation:
        """Take in a reading, shape (n,) [m]."""
        noise, extra = self._noise, self._extra()
        predicted = self._known + extra[self._group_of]
        innovations, worth, chi2 = self._weigh(reading, predicted)
        doubt = float(self._weights.dot(extra / (self._group_known + noise)))
        kick = chi2 > self.settings.kick_chi2
        if kick:
            self._surprise()
            predicted = self._known
            worth = innovations / (predicted + noise)
        shares = noise / (self._variances + noise)
        if not kick:
            self._kicks = max(0.0, self._kicks - _KICK_FADES)
            self._coefficients.learn(worth, shares[-len(extra) :], noise)
        self._orbit += predicted * worth
        self._variances *= shares
        if not self.settings.noise_model:
            self._orbit[:] = reading @ self.modes
            self._forget_orbit(noise)
        return Innovation(chi2, doubt, kick)

    def _weigh(self, reading: Vector, predicted: Vector) -> tuple[Vector, Vector, float]:
        """Compare a reading, shape (n,) [m], with the orbits that were predicted.

        Args:
            reading: The orbit.
            predicted: Variance of the predicted orbit of every mode, shape (n,) [m²].

        Returns:
            The innovations, shape (n,) [m]; the same over their variances, (n,) [1/m]; and the
            mean of their squares over their variances [1].
        """
        innovations = reading.dot(self.modes)
        innovations -= self._orbit
        worth = innovations / (predicted + self._noise)
        return innovations, worth, float(innovations.dot(worth)) / len(innovations)

    def _extra(self) -> Vector:
        """Variance of the predicted orbit that not knowing R makes, of every group [m²]."""
        return np.maximum(self._group_variances - self._group_known, 0.0)

    def _covariances(self, size: int) -> tuple[Vector, ...]:
        self._add_drift()
        return self._coefficients.covariances(size)

    def _forget_orbit(self, variance: float) -> None:
        """Know nothing of the orbit but that its variance is this one [m²]."""
        self._variances[:] = variance
        self._coefficients.forget_orbit()

    def _surprise(self) -> None:
        self._kicks += 1.0
        if self._kicks > _KICKS:
            most = self._widest / self._coefficients.traces()
            self._coefficients.widen(np.clip(most, 1.0, _WIDENING))
        self.reset()

    def _add_drift(self) -> None:
        """Add what the random walk of R has done since it was last added."""
        if self._since_drift:
            self._coefficients.add_drift(self._since_drift)
            self._since_drift = 0
