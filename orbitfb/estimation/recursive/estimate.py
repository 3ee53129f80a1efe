"""Track the response matrix at every tick, while the loop runs: Bayesian and unbiased.

With the orbit x, the change a and the reading y of a mode, of which R_i is the row of UᵀR,

    x_{n+1} = x_n + R_i a_n + b + w_n,     y_n = x_n + v_n,

x and the coefficients θ = (R_i, b) are one Gaussian state. Its Kalman filter needs, of every
group of modes that share their noise, the covariance P of θ, the vector c = cov(θ, x) and the
number p = var(x). With the regressor u = (a, 1), or what stands for 1 where the creep grows with
what is held (`orbitfb.estimation.recursive.held`), a tick is

    p ← p + uᵀ(2c + P u) + q,   c ← c + P u,   x̂ ← x̂ + θ̂ᵀ u          (prediction)
    S = p + r²,   ν = y − x̂,
    θ̂ ← θ̂ + c ν / S,   P ← P − c cᵀ / S,   x̂ ← x̂ + p ν / S,   (c, p) ← (c, p) r² / S.

With c = P φ this is the recursive regression of innovations on prefiltered changes φ, with the
filter that the knowledge of x calls for at every tick. The reading noise that a feedback writes
into its change and into the next difference of readings does not bias it, as it does the naive
regression. Between ticks R walks at random: P ← P + Q.

b is the creep that a drift of R makes of setpoints that stay. x̂ has in every mode the gain of
that mode's own noise; only P is shared within a group. R is learnt in blocks of ticks, which
changes nothing of what is known at their ends (`orbitfb.estimation.recursive.coefficients`). Until
then x̂ is filtered as if R were known. So a block is as long as little is to be learnt of R, and
a reading that surprises is learnt from at once.

A reading that nothing explains is a kick of the orbit: x is forgotten, R is not. Several in a row
say that R is not what it was, and its covariance is widened.

Source: the Kalman filter of the augmented state, e.g. Ljung and Söderström, Theory and Practice
of Recursive Identification (1983), ch. 3.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import Columns, KnownRf
from orbitfb.estimation.recursive.block import Block
from orbitfb.estimation.recursive.coefficients import Coefficients
from orbitfb.estimation.recursive.group import make_groups, step_variances
from orbitfb.estimation.recursive.held import HeldCurrents
from orbitfb.estimation.recursive.kicks import Kicks
from orbitfb.estimation.recursive.orbit import OrbitFilter, at_rest
from orbitfb.estimation.recursive.said import Filtered, Innovation
from orbitfb.estimation.recursive.settings import RecursiveSettings

_SURPRISING = 1.5
"""Mean square of the innovations, over what it is if R is known, from which a reading is weighed
and learnt from at once [1]: what is not known of R adds a half then, which calls for a new gain
(`CautionSettings.doubt`)."""
_TOLD = 0.5
"""Sum of the doubts of a block's readings from which it ends [1], twice the nats that they can tell
of R. By hand of 0.3, 0.5, 0.7, 1 and 2: on 12 drifting rings (seeds 500 to 511) the orbit of four
minutes is the same up to 0.7, and 3 % larger with 1; more costs less."""
_PRECISION = np.float32
"""Of R̂, its covariance and the products with them, in which the time goes; the orbit and all that
the readings of a block have in common is double."""
_DIFFUSE = 1e8
"""Variance of an orbit of which nothing is known, over that of the reading noise."""


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
        count, sizes = len(groups), [group.size for group in groups]
        self._coefficients = Coefficients(groups, drift, settings.drift_every, _PRECISION)
        self._block = Block(len(drift), n, count, settings.drift_every, self._noise, _PRECISION)
        self._kicks = Kicks(self._coefficients)
        self._orbit = np.zeros(n)
        self._looking = self.modes.astype(_PRECISION)
        self._weights, self._group_of = np.array(sizes) / n, np.repeat(np.arange(count), sizes)
        steps = np.array([*self._steps, *(group.step for group in groups)])
        self._filter = OrbitFilter(steps, self._noise)
        self._creeps = settings.creep > 0.0
        self._held = HeldCurrents(self._size, settings.creep_held)
        self._since_drift, self._doubt, self._told = 0, 0.0, 0.0
        self.reset()

    @property
    def rows(self) -> Vector:
        """Rows of UᵀR̂ as columns, shape (m, n)."""
        self.settle()
        return self._coefficients.rows[:, : self._size].T.astype(np.float64)

    @property
    def response(self) -> Vector:
        """R̂ as it stands, shape (n, m)."""
        return self.modes @ self.rows.T

    @property
    def creep(self) -> Vector:
        """The creep b̂ in every mode, shape (n,) [m/tick]."""
        if not self._creeps:
            return np.zeros(len(self._orbit))
        return self._held.load * self._coefficients.rows[:, -1].astype(np.float64)

    @property
    def column(self) -> Vector | None:
        """The RF column as it stands, shape (n,) [m/Hz]; None: the RF does not step."""
        if self._columns.rf is None:
            return None
        self.settle()
        column = self._coefficients.rows[:, self._size].astype(np.float64)
        return self.modes @ column / self._columns.unit

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
        usual = np.sum(self._filter.variances[: len(self._orbit)] + self._steps)
        return float(np.sqrt(self._orbit @ self._orbit / usual))

    @property
    def floor(self) -> Vector:
        """Variance of the predicted orbit of every mode at rest, if R is known, (n,) [m²]."""
        return at_rest(self._steps, self._noise)

    @property
    def covariance(self) -> Vector:
        """Covariance of a row of R̂, mean over the rows, shape (m, m)."""
        return self.weighted_covariance(np.full(len(self._orbit), 1.0 / len(self._orbit)))

    def weighted_covariance(self, weights: Vector) -> Vector:
        """Sum the covariances of all rows of UᵀR̂ with weights of the rows, shape (m, m)."""
        shares = np.array([np.sum(weights[members]) for members in self.groups])
        return self._covariance(shares)

    def weakest_covariance(self) -> Vector:
        """Give the covariance of a row of the weakest modes, shape (m, m)."""
        return self._covariance(np.arange(len(self.groups)) == len(self.groups) - 1)

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

    def settle(self) -> None:
        """Learn of R what was read so far, at whatever tick of a block."""
        if self._block.is_empty:
            return
        self._orbit += self._coefficients.learn(self._block)
        self._doubt = float(self._weights.dot(self._coefficients.doubt))
        self._told = 0.0
        self._block.begin()

    def reset(self) -> None:
        """Forget the orbit, not R: before the first reading, after a gap or a kick."""
        self._forget_orbit(_DIFFUSE * self._noise)

    def predict(self, change: Vector, hertz: float = 0.0) -> None:
        """Take in the change, shape (m,), that was made after the last reading.

        Args:
            change: Of the setpoints.
            hertz: The step of the RF that went with it [Hz].
        """
        self._since_drift += 1
        if self._since_drift >= self.settings.drift_every:
            self._add_drift()
        regressor = self._block.next()
        regressor[: self._size] = change
        if self._creeps:
            self._held.add(change)
            regressor[-1] = self._held.load
        if self._columns.rf is not None:
            regressor[self._size] = hertz / self._columns.unit
        self._orbit += self._coefficients.rows.dot(regressor)
        self._filter.predict()

    def filtered(self, reading: Vector) -> Filtered:
        """Say where a reading, shape (n,) [m], puts the orbit; nothing is taken in."""
        noise, n, shares = self._noise, len(reading), self._filter.weigh()[1]
        innovations = self._innovations(reading)
        unexplained, chi2 = self._weighed(innovations, shares[:n])
        if chi2 >= _SURPRISING:
            doubted = self._with_doubt(self._filter.weigh()[0][:n])
            innovations = self._innovations(reading)
            unexplained, chi2 = self._weighed(innovations, noise / doubted)
        if chi2 > self.settings.kick_chi2:
            orbit, known = self._orbit + innovations, np.full(n, noise)
        else:
            orbit = self._orbit + innovations - unexplained
            known = noise * (1.0 - shares[:n])
        usual = float(np.sum(known + self._steps))
        return Filtered(orbit + self.creep, float(np.sqrt(orbit @ orbit / usual)))

    def read(self, reading: Vector) -> Innovation:
        """Take in a reading, shape (n,) [m]."""
        n, (variances, shares) = len(reading), self._filter.weigh()
        if self._block.is_full:
            self.settle()
        innovations = self._innovations(reading)
        unexplained, chi2 = self._weighed(innovations, shares[:n])
        at_once = chi2 >= _SURPRISING or not self.settings.noise_model
        if at_once:
            doubted = self._with_doubt(variances[:n])
            innovations = self._innovations(reading)
            chi2 = self._weighed(innovations, self._noise / doubted)[1]
            unexplained = shares[:n] * innovations
        else:
            chi2 /= 1.0 + self._doubt
        kick = chi2 > self.settings.kick_chi2
        if kick:
            self._kicks.count()
            self.reset()
            unexplained = self._filter.weigh()[1][:n] * innovations
        else:
            self._kicks.fade()
            self._block.read(innovations, variances)
        self._orbit += innovations
        self._orbit -= unexplained
        self._filter.update()
        self._told += self._doubt
        if at_once or self._told > _TOLD:
            self.settle()
        if not self.settings.noise_model:
            self._orbit[:] = reading @ self.modes
            self._forget_orbit(self._noise)
        return Innovation(chi2, self._doubt, kick)

    def _innovations(self, reading: Vector) -> Vector:
        """Give what a reading is beyond what is expected, in modes, shape (n,) [m]."""
        return reading.astype(_PRECISION).dot(self._looking) - self._orbit

    def _weighed(self, innovations: Vector, shares: Vector) -> tuple[Vector, float]:
        """Give what of the innovations is noise, (n,) [m], and their mean square over variances.

        Args:
            innovations: Shape (n,) [m].
            shares: r² over the variances, shape (n,) [1].
        """
        noise = shares * innovations
        return noise, float(innovations.dot(noise)) / (self._noise * len(noise))

    def _with_doubt(self, variances: Vector) -> Vector:
        """Learn, and add what is still not known of R to the variances, shape (n,) [m²]."""
        self.settle()
        return variances + self._coefficients.extra[self._group_of]

    def _covariance(self, shares: Vector) -> Vector:
        self._add_drift()
        return self._coefficients.covariance(self._size, shares)

    def _covariances(self, size: int) -> tuple[Vector, ...]:
        self._add_drift()
        return self._coefficients.covariances(size)

    def _forget_orbit(self, variance: float) -> None:
        """Know nothing of the orbit but that its variance is this one [m²]."""
        self.settle()
        self._filter.forget(variance)
        self._coefficients.forget_orbit()

    def _add_drift(self) -> None:
        """Learn, and add what the random walk of R has done since it was last added."""
        self.settle()
        if self._since_drift:
            self._coefficients.add_drift(self._since_drift)
            if self._creeps:
                self._coefficients.turn(self._held.turned())
            self._since_drift = 0
