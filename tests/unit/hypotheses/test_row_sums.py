"""Sums over rows against the sums over frequencies that they stand for."""

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.row_sums import OwnError, Rows, moving_root
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform

BPMS, ROWS = 24, 1201


@pytest.fixture(scope="module")
def transform() -> StepTransform:
    starts = np.zeros(ROWS, dtype=np.bool_)
    starts[0] = True
    return StepTransform.of(starts)


@pytest.fixture(scope="module")
def noise() -> StepNoise:
    """Modes that hardly walk beside some that walk more than they are noisy."""
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((BPMS, BPMS)))[0]
    return StepNoise((turned * np.geomspace(1e-5, 3.0, BPMS)) @ turned.T, np.eye(BPMS))


@pytest.fixture(scope="module")
def courses() -> Matrix:
    """One that goes on and one that jitters."""
    rng = np.random.default_rng(2)
    return np.stack([rng.standard_normal(ROWS).cumsum(), rng.standard_normal(ROWS)], axis=1)


def exactly(pattern: Vector, course: Matrix, noise: StepNoise, transform: StepTransform) -> Matrix:
    """Information between courses of a pattern, from every frequency and mode, shape (k, k)."""
    spectrum = transform.spectrum(course)
    weight = (1.0 / noise.variance(transform)) @ ((pattern @ noise.modes) ** 2)
    return (spectrum * weight[:, None]).T @ spectrum


def test_information_by_rows_is_that_by_frequencies(
    noise: StepNoise, transform: StepTransform, courses: Matrix
) -> None:
    rng = np.random.default_rng(3)
    rows = Rows.of(np.zeros((len(transform), BPMS)), noise, transform)
    for _ in range(5):
        pattern = rng.standard_normal(BPMS)
        _, found = rows.weighed(pattern, transform.steps(courses), None)
        exact = np.diag(exactly(pattern, courses, noise, transform))
        assert found == pytest.approx(exact, rel=0.15)


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_what_begins_soon_has_what_a_healthy_error_of_the_same_course_leaves_it(
    noise: StepNoise, transform: StepTransform, courses: Matrix, seed: int
) -> None:
    """A hundredth is left: right to a factor, where sums of two kinds leave nothing."""
    pattern, onset = np.random.default_rng(seed).standard_normal(BPMS), 60
    whole = courses[:, :1]
    late = np.where(np.arange(ROWS)[:, None] < onset, 0.0, whole - whole[onset])
    both = exactly(pattern, np.hstack([whole, late]), noise, transform)
    known = 1e-6 * both[0, 0]
    expected = both[1, 1] - both[0, 1] ** 2 / (known + both[0, 0])
    spectrum = transform.quick_spectrum(whole)
    rows = Rows.of(np.zeros((len(transform), BPMS)), noise, transform)
    whitened = rows.whitened(transform.turn(spectrum))
    error = OwnError(0, spectrum, whitened, np.array([1.0 / known]), both[:1, 0])
    _, found = rows.weighed(pattern, transform.steps(late), error)
    assert expected / 3.4 < found[0] < 3.4 * expected
    onsets = np.arange(0, len(transform), 10)
    _, since = rows.since(pattern[:, None], transform.turn(spectrum), onsets, error)
    assert expected / 3.4 < since[onsets == onset, 0][0] < 3.4 * expected


def test_what_begins_together_has_what_the_errors_of_all_its_devices_leave_it(
    noise: StepNoise, transform: StepTransform
) -> None:
    """They share much of what they do here; the errors' part is that of each for itself."""
    rng, onset = np.random.default_rng(7), 600
    shared = rng.standard_normal((BPMS, 1))
    patterns = shared + 0.7 * rng.standard_normal((BPMS, 3))
    courses = rng.standard_normal((ROWS, 3)).cumsum(axis=0)
    late = np.where(np.arange(ROWS)[:, None] < onset, 0.0, courses - courses[onset])
    fields = [np.outer(its, p) for its, p in zip(courses.T, patterns.T, strict=True)]
    fields.append(late @ patterns.T)
    seen = [transform.spectrum(one) @ noise.modes for one in fields]
    exact = np.array([[np.sum(a * b / noise.variance(transform)) for b in seen] for a in seen])
    known = 0.1 * np.diag(exact)[:3]
    cross, inner = exact[:3, 3], exact[:3, :3] + np.diag(known)
    expected = exact[3, 3] - cross @ np.linalg.solve(inner, cross)
    spectrum = transform.quick_spectrum(courses)
    steps = transform.turn(spectrum)
    rows, onsets = Rows.of(np.zeros((len(transform), BPMS)), noise, transform), np.array([onset])
    errors = OwnError(0, spectrum, rows.whitened(steps), 1.0 / known, np.diag(exact)[:3])
    three = [np.arange(3)]
    _, alone = rows.since(patterns, steps, onsets, None, three)
    assert alone[0, 3] == pytest.approx(exact[3, 3], rel=0.15)
    _, left = rows.since(patterns, steps, onsets, errors, three)
    assert left[0, 3] == pytest.approx(expected, rel=0.35)


def test_a_mode_that_hardly_has_noise_has_a_root() -> None:
    """Its motion is all that is read: the root is noise over walk, and not rounded to none."""
    assert moving_root(np.array([1e12])) == pytest.approx(1e-12)
    assert moving_root(np.array([0.5])) == pytest.approx(0.5)
