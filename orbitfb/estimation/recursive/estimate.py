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
that mode's own noise; only P is shared within a group.

A reading that nothing explains is a kick of the orbit: x is forgotten, R is not. Several in a row
say that R is not what it was, and its covariance is widened.

Source: the Kalman filter of the augmented state, e.g. Ljung and Söderström, Theory and Practice
of Recursive Identification (1983), ch. 3.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import Columns, KnownRf
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
        groups: Estimate and covariance of the rows, strongest modes first.
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
        self.groups, self._drift = make_groups(rows, columns, whole, self._steps, settings)
        for group, covariance in zip(self.groups, covariances or (), strict=False):
            known = slice(min(len(covariance), columns.actuators))
            group.covariance[known, known] = covariance[known, known]
        self._widest = [_WIDEST * float(np.trace(group.covariance)) for group in self.groups]
        self._regressor = np.ones(len(self._drift))
        self._orbit = np.zeros(n)
        self._known = np.zeros(n)
        self._since_drift = 0
        self._kicks = 0.0
        self.reset()

    @property
    def rows(self) -> Vector:
        """Rows of UᵀR̂ as columns, shape (m, n)."""
        return np.concatenate([group.rows[: self._size] for group in self.groups], axis=1)

    @property
    def response(self) -> Vector:
        """R̂ as it stands, shape (n, m)."""
        return self.modes @ self.rows.T

    @property
    def creep(self) -> Vector:
        """The creep b̂ in every mode, shape (n,) [m/tick]."""
        if self.settings.creep == 0.0:
            return np.zeros(len(self._orbit))
        return np.concatenate([group.rows[-1] for group in self.groups])

    @property
    def column(self) -> Vector | None:
        """The RF column as it stands, shape (n,) [m/Hz]; None: the RF does not step."""
        if self._columns.rf is None:
            return None
        rows = np.concatenate([group.rows[self._size] for group in self.groups])
        return self.modes @ rows / self._columns.unit

    @property
    def orbit(self) -> Vector:
        """The filtered orbit x̂, shape (n,) [m]."""
        return self.modes @ self._orbit

    @property
    def covariances(self) -> tuple[Vector, ...]:
        """Covariance of a row of UᵀR in every group, copied, each of shape (m, m)."""
        return tuple(part[: self._size, : self._size] for part in self.whole_covariances)

    @property
    def whole_covariances(self) -> tuple[Vector, ...]:
        """The same with the RF column behind the correctors, if it is one."""
        self._add_drift()
        return tuple(group.whole_covariance(self._columns.actuators) for group in self.groups)

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
        self._add_drift()
        m = self._size
        total = np.zeros((m, m))
        for group in self.groups:
            total += float(np.sum(weights[group.members])) * group.whole_covariance(m)
        return total

    def weakest_covariance(self) -> Vector:
        """Give the covariance of a row of the weakest modes, shape (m, m)."""
        self._add_drift()
        return self.groups[-1].whole_covariance(self._size)

    def normalised_errors(self, response: Vector) -> Vector:
        """Errors against a known response in units of the stated uncertainty.

        Args:
            response: The true R, shape (n, m).

        Returns:
            Shape (n, m), by mode and by principal direction of the covariance of its group;
            independent standard normal numbers when the stated uncertainty is right.
        """
        error = self.rows.T - self.modes.T @ response
        for group, covariance in zip(self.groups, self.covariances, strict=True):
            values, directions = np.linalg.eigh(covariance)
            error[group.members] = (error[group.members] @ directions) / np.sqrt(values)
        return error

    def reset(self) -> None:
        """Forget the orbit, not R: before the first reading, after a gap or a kick."""
        variance = _DIFFUSE * self._noise
        self._known[:] = variance
        for group in self.groups:
            group.forget_orbit(variance)

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
        for group in self.groups:
            self._orbit[group.members] += group.predict(self._regressor)
        self._known += self._steps

    def filtered(self, reading: Vector) -> Filtered:
        """Say where a reading, shape (n,) [m], puts the orbit; nothing is taken in."""
        noise, orbit = self._noise, reading @ self.modes
        innovations = orbit - self._orbit
        predicted = self._predicted()
        variances = predicted + noise
        known = self._known
        if float(np.mean(innovations**2 / variances)) > self.settings.kick_chi2:
            known = np.full(len(orbit), noise)
        else:
            orbit = self._orbit + predicted / variances * innovations
            known = known * (noise / (known + noise))
        usual = float(np.sum(known + self._steps))
        return Filtered(orbit + self.creep, float(np.sqrt(orbit @ orbit / usual)))

    def read(self, reading: Vector) -> Innovation:
        """Take in a reading, shape (n,) [m]."""
        noise = self._noise
        innovations = reading @ self.modes
        innovations -= self._orbit
        predicted = self._predicted()
        variances = predicted + noise
        worth = innovations / variances
        chi2 = float(innovations @ worth) / len(innovations)
        doubt = sum(g.size * g.extra / (g.known + noise) for g in self.groups) / len(innovations)
        kick = chi2 > self.settings.kick_chi2
        if kick:
            self._surprise()
            predicted = self._predicted()
            worth = innovations / (predicted + noise)
        else:
            self._kicks = max(0.0, self._kicks - _KICK_FADES)
            for group in self.groups:
                group.learn(worth[group.members], noise)
        worth *= predicted
        self._orbit += worth
        self._known *= noise / (self._known + noise)
        for group in self.groups:
            group.observe(noise)
        if not self.settings.noise_model:
            self._believe(reading)
        return Innovation(chi2, doubt, kick)

    def _predicted(self) -> Vector:
        """Variance of the predicted orbit of every mode, what is not known of R with it [m²]."""
        predicted = self._known.copy()
        for group in self.groups:
            predicted[group.members] += group.extra
        return predicted

    def _believe(self, reading: Vector) -> None:
        """Take the reading for the orbit, as the naive regression does."""
        self._orbit[:] = reading @ self.modes
        self._known[:] = self._noise
        for group in self.groups:
            group.forget_orbit(self._noise)

    def _surprise(self) -> None:
        self._kicks += 1.0
        if self._kicks > _KICKS:
            for group, most in zip(self.groups, self._widest, strict=True):
                size = float(np.trace(group.covariance))
                group.covariance *= min(_WIDENING, max(most / size, 1.0))
        self.reset()

    def _add_drift(self) -> None:
        """Add what the random walk of R has done since it was last added."""
        if self._since_drift:
            for group in self.groups:
                group.covariance += self._since_drift * self._drift
                size = len(group.drift)
                group.covariance.ravel(order="K")[:: size + 1] += self._since_drift * group.drift
            self._since_drift = 0
