"""The estimate, which is brought up to date in blocks of ticks, against a plain Kalman filter."""

import numpy as np
import pytest

from orbitfb.estimation.columns import KnownRf
from orbitfb.estimation.recursive import estimate as module
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.estimation.recursive.settings import RecursiveSettings
from orbitfb.policies.adaptive_settings import TrackingSettings

NOISE, WHITE, TICKS = 0.2e-6, 0.05e-6, 300
KICKS = (60, 61, 62, 150, 233)
"""Ticks at which the orbit jumps. The third in a row widens what is not known of R."""
DIFFUSE, WIDENED = 1e8, 4.0


class Textbook:
    """Kalman filter of the coefficients and the orbit of every mode, a matrix for each of them.

    Args:
        rows: Coefficients to begin with, shape (n, k).
        covariances: Theirs, shape (n, k, k).
        drifts: What a tick adds to these, shape (n, k, k).
    """

    def __init__(self, rows, covariances, drifts):
        n, k = rows.shape
        self.state = np.column_stack([rows, np.zeros(n)])
        self.drifts = drifts
        self.covariance = np.zeros((n, k + 1, k + 1))
        self.covariance[:, :k, :k] = covariances
        self.forget()

    def forget(self):
        self.covariance[:, -1, :] = self.covariance[:, :, -1] = 0.0
        self.covariance[:, -1, -1] = DIFFUSE * NOISE**2

    def drift(self, ticks):
        self.covariance[:, :-1, :-1] += ticks * self.drifts

    def turn(self, kept, priors):
        """Of the creep, the last coefficient, a share stays known."""
        step = np.diag([*np.ones(len(self.state[0]) - 2), kept, 1.0])
        self.state = self.state @ step
        self.covariance = step @ self.covariance @ step
        self.covariance[:, -2, -2] += (1.0 - kept**2) * priors

    def predict(self, regressor):
        step = np.eye(len(regressor) + 1)
        step[-1, :-1] = regressor
        self.state = self.state @ step.T
        self.covariance = step @ self.covariance @ step.T
        self.covariance[:, -1, -1] += WHITE**2

    def read(self, modes, widen):
        """Give whether the reading of the modes is taken for a kick."""
        innovation = modes - self.state[:, -1]
        kick = np.mean(innovation**2 / (self.covariance[:, -1, -1] + NOISE**2)) > 25.0
        if kick:
            self.covariance[:, :-1, :-1] *= WIDENED if widen else 1.0
            self.forget()
        column = self.covariance[:, :, -1]
        total = column[:, -1] + NOISE**2
        self.state = self.state + column * (innovation / total)[:, None]
        taken = column[:, :, None] * column[:, None, :]
        self.covariance = self.covariance - taken / total[:, None, None]
        return kick


def textbook(estimate, whole, settings, unit, energy):
    """Make the plain filter with what the settings say, as `docs` and the module have it."""
    m = whole.shape[1] - (unit is not None)
    rows = estimate.modes.T @ whole
    prior = np.diag([settings.prior_entry**2] * whole.shape[1])
    drift = np.diag([settings.drift_entry**2] * m + [0.0] * (unit is not None))
    if unit is not None:
        size = settings.rf_error**2 * np.mean(whole[:, m] ** 2)
        prior[:m, :m] += size * np.outer(2.0 * energy / unit, 2.0 * energy / unit)
        prior[m, m] = size
    if not settings.creep:
        return Textbook(rows, np.array([prior] * len(rows)), np.array([drift] * len(rows)))
    power, creep = np.sum(rows[:, :m] ** 2, axis=1), np.zeros(len(rows))
    for members in estimate.groups:
        level = np.exp(np.mean(np.log(power[members]))) / np.mean(power[members])
        share = level * np.mean(power[members]) / np.mean(power)
        creep[members] = settings.creep**2 * share + settings.creep_white**2
    k = len(prior) + 1
    priors, drifts = np.zeros((2, len(rows), k, k))
    priors[:, :-1, :-1], priors[:, -1, -1] = prior, creep
    drifts[:, :-1, :-1], drifts[:, -1, -1] = drift, creep / settings.creep_memory
    return Textbook(np.column_stack([rows, np.zeros(len(rows))]), priors, drifts)


class Held:
    """Currents, and one that nobody changes, as a vector whose length and angles are looked at."""

    def __init__(self, size, norm):
        self.norm = norm
        self.now = self.then = np.append(np.zeros(size), norm)

    def add(self, change):
        self.now = self.now + np.append(change, 0.0)
        return np.linalg.norm(self.now) / self.norm

    def turned(self):
        both = np.linalg.norm(self.now) * np.linalg.norm(self.then)
        cosine, self.then = self.now @ self.then / both, self.now
        return cosine


@pytest.mark.parametrize(
    ("surprising", "settled"),
    [(1.5, 1), (1.5, 4), (0.0, 5), (np.inf, 1), (np.inf, 6), (np.inf, 25)],
)
@pytest.mark.parametrize(
    ("n", "m", "groups", "every", "creep", "tracked", "held"),
    [
        (7, 9, 3, 10, 0.0, False, None),
        (8, 6, 1, 1, 3e-8, False, None),
        (12, 14, 12, 7, 3e-8, True, None),
        (12, 14, 12, 7, 3e-8, True, 3e-5),
    ],
)
def test_equals_a_plain_kalman_filter_of_every_mode(
    n, m, groups, every, creep, tracked, held, surprising, settled, monkeypatch
):
    """However long the blocks are: without surprises up to `every` ticks, else down to one."""
    monkeypatch.setattr(module, "_PRECISION", np.float64)
    monkeypatch.setattr(module, "_SURPRISING", surprising)
    monkeypatch.setattr(module, "_TOLD", surprising)
    kicks = KICKS if surprising < np.inf else ()  # what surprises nobody is no kick
    generator = np.random.default_rng(n)
    first = generator.standard_normal((n, m)) * np.geomspace(3.0, 0.3, m)
    told, energy = generator.standard_normal(n) * 1e-6, 50.0 * generator.standard_normal(m)
    settings = RecursiveSettings(
        reading_noise=NOISE, white=WHITE, minimum_gain=1e-6, prior_entry=0.05, drift_entry=1e-3,
        drift_every=every, creep=creep, creep_held=held, groups=groups,
    )  # fmt: skip
    estimate = RecursiveResponse(first, settings, rf=KnownRf(told, energy) if tracked else None)
    unit = np.linalg.norm(first) / np.sqrt(m) / np.linalg.norm(told) if tracked else None
    whole = np.column_stack([first, unit * told]) if tracked else first
    plain = textbook(estimate, whole, settings, unit, energy)
    assert (len(estimate.groups) > 1) == (groups > 1)
    currents, creeps = Held(m, held or 1e9), plain.covariance[:, -2, -2].copy()

    truth, orbit, kicked = first + 0.05 * generator.standard_normal((n, m)), np.zeros(n), []
    for tick in range(TICKS):
        orbit = orbit + 1e-3 * (tick in kicks) * generator.standard_normal(n)
        reading = orbit + NOISE * generator.standard_normal(n)
        said = estimate.read(reading)
        kicked += [tick] if said.kick else []
        assert plain.read(reading @ estimate.modes, widen=tick == KICKS[2] and kicks) == said.kick

        change, hertz = 3e-6 * generator.standard_normal(m), generator.standard_normal() * tracked
        if tick % every == every - 1:
            plain.drift(every)
            if creep:
                plain.turn(currents.turned(), creeps)
        load = currents.add(change)
        regressor = [*change, *([hertz / unit] if tracked else []), *([load] if creep else [])]
        estimate.predict(change, hertz)
        plain.predict(np.array(regressor))
        orbit = orbit + truth @ change + 1.2 * hertz * told + WHITE * generator.standard_normal(n)

        if tick % settled == 0:
            estimate.settle()
            its = estimate.orbit @ estimate.modes
            np.testing.assert_allclose(its, plain.state[:, -1], atol=1e-14)
        if creep and tick % settled == 0:
            np.testing.assert_allclose(estimate.creep, load * plain.state[:, -2], atol=1e-15)
        if tick % every == every - 1 and tick % 3 == 0:  # what is read changes nothing
            found = (estimate.modes @ plain.state)[:, :m]
            np.testing.assert_allclose(estimate.response, found, atol=1e-9)
            for members, part in zip(estimate.groups, estimate.whole_covariances, strict=True):
                its = plain.covariance[members, : len(part), : len(part)]
                np.testing.assert_allclose(its, np.broadcast_to(part, its.shape), atol=1e-11)
    assert tuple(kicked) == kicks
    if tracked:
        np.testing.assert_allclose(
            estimate.column * unit, estimate.modes @ plain.state[:, m], rtol=1e-6
        )


@pytest.mark.parametrize("kick", [0.0, 3e-6, pytest.param(1e-3, id="beyond all measure")])
def test_single_precision_is_lost_among_what_is_not_known(kick, monkeypatch):
    """Over thousands of ticks in closed loop: of R and P in units of what is not known."""
    n, noise = 40, 0.2e-6
    generator = np.random.default_rng(11)
    left, right = (np.linalg.qr(generator.standard_normal((n, n)))[0] for _ in range(2))
    truth = left @ np.diag(np.geomspace(1e-3, 2e-6, n)) @ right
    settings = TrackingSettings(reading_noise=noise)
    estimates = []
    for precision in (np.float32, np.float64):
        monkeypatch.setattr(module, "_PRECISION", precision)
        estimates.append(RecursiveResponse(truth, settings))
    gain = np.linalg.inv(truth)
    truth = truth + 0.1 * settings.prior_entry * generator.standard_normal((n, n))
    orbit = np.zeros(n)
    for tick in range(1500):
        orbit = orbit + kick * (tick in (600, 601, 1000)) * generator.standard_normal(n)
        reading = orbit + noise * generator.standard_normal(n)
        for estimate in estimates:
            estimate.read(reading)
        change = -0.5 * gain @ estimates[1].expected
        for estimate in estimates:
            estimate.predict(change)
        orbit = orbit + truth @ change + 0.04e-6 * generator.standard_normal(n)
        if tick % 100 == 99:
            single, double = estimates
            told, exact = (np.std(e.normalised_errors(truth)) for e in estimates)
            assert told < 1.1 * exact + 0.01
            if kick > 1e-4:  # hundreds of amperes, whose squares are not resolved
                continue
            assert np.std(single.normalised_errors(double.response)) < 1e-3
            for its, exact in zip(single.covariances, double.covariances, strict=True):
                ratios = np.linalg.eigvals(np.linalg.solve(exact, its)).real
                np.testing.assert_allclose(ratios, 1.0, atol=0.01)
