"""What size of every effect the record would have shown: what stands behind each "not found".

Terms of information H show a size θ with ½ H θ² nats; 5 standard deviations are 12.5 of them. Of a
law that scales the size follows at once, of another one the values of its grid are halved until the
smallest that shows is found. What never moves, as an offset, leaves no trace unless it begins
within the record: half-way, say. A random amplitude of variance κ has the information
½ Σ_b n_b (pᵀΩ_b p)² about κ.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.result.parts import Detectable
from orbitfb.effects.kinds import EffectKind, Parameter, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw, Law, RandomLaw
from orbitfb.estimation.priors import SIGMAS

_ENOUGH = SIGMAS**2 / 2.0
"""Log likelihood [nats] of a size of so many standard deviations."""


def detectable(kinds: Sequence[EffectKind], scorer: Scorer) -> tuple[Detectable, ...]:
    """Tell the smallest size that shows, of every effect that has one; causes are in the model.

    Args:
        kinds: Effects that were tested.
        scorer: Of what the causes leave.
    """
    found: list[Detectable] = []
    for kind in kinds:
        sized = next(iter(kind.fitted(scorer.space.signals.record)), None)
        laws = scorer.space.courses.laws(kind)
        if sized is None or sized.meanings or not laws:
            continue
        sizes = _sizes(kind, sized, laws[0], scorer)
        if sizes is None:
            continue
        found.append(
            Detectable(
                effect=kind.id, parameter=sized.name, unit=sized.unit,
                size=_sensible(sized, float(np.median(sizes))),
                best=_sensible(sized, float(np.min(sizes))),
            )
        )  # fmt: skip
    return tuple(found)


def _sensible(sized: Parameter, size: float) -> float | None:
    """A size, if a device may have it, and it is one."""
    largest = max(sized.high - sized.nominal, sized.nominal - sized.low)
    return size if np.isfinite(size) and 0.0 < size <= largest else None


def _sizes(kind: EffectKind, sized: Parameter, law: Law, scorer: Scorer) -> Vector | None:
    """Smallest size that shows at every place, infinite where none does; None of other laws."""
    if isinstance(law, RandomLaw):
        return None if law.relative or law.lag else np.abs(_random(law, scorer) - sized.nominal)
    if isinstance(law, FieldLaw) or (isinstance(law, DeviceLaw) and not law.periodic):
        return _of_grid(kind, sized, law, scorer)
    return None


def _of_grid(
    kind: EffectKind, sized: Parameter, law: DeviceLaw | FieldLaw, scorer: Scorer
) -> Vector | None:
    grid = [
        values
        for values in scorer.space.courses.grid(kind)
        if values.get(sized.name, sized.nominal) != sized.nominal
    ]
    if not grid:
        return None
    falling = sized.nominal >= sized.high
    grid.sort(key=lambda values: _distance(sized, values[sized.name]))
    if sized in kind.sizes:
        reach = abs(grid[0][sized.name] - sized.nominal)
        worth = _information(kind, law, grid[0], scorer)
        with np.errstate(divide="ignore"):
            return reach * SIGMAS / np.sqrt(worth)
    low, high = -1, len(grid)
    while high - low > 1:  # the first one that shows at half of the places
        middle = (low + high) // 2
        if np.median(_information(kind, law, grid[middle], scorer)) > 2.0 * _ENOUGH:
            high = middle
        else:
            low = middle
    if high == len(grid):
        return np.array([np.inf])
    value = grid[high][sized.name]
    size = value if falling else abs(value - sized.nominal)
    return np.array([size])


def _distance(sized: Parameter, value: float) -> float:
    """From nothing; what is nothing at its largest value is small when it is large."""
    return -value if sized.nominal >= sized.high else abs(value - sized.nominal)


def _information(
    kind: EffectKind, law: DeviceLaw | FieldLaw, values: Values, scorer: Scorer
) -> Vector:
    """Σ sᵀΩs of a law with given values, at every place for itself, shape (D,)."""
    courses, transform = scorer.space.courses, scorer.space.transform
    if isinstance(law, FieldLaw):
        field = courses.field(law, values)
        return np.atleast_1d(np.sum(((field @ scorer.space.noise.modes) ** 2) * scorer.weights))
    total = np.zeros(len(law.names))
    spectra = _spectra(law, values, scorer)
    for pattern, spectrum in zip(law.patterns, spectra, strict=True):
        seen = scorer.seen(pattern)
        total += np.einsum("bd,bd->d", seen.own, transform.by_band(spectrum * spectrum))
    if len(law.patterns) > 1:
        return total
    return _beside_healthy(kind, law, spectra[0], total, scorer)


def _beside_healthy(
    kind: EffectKind, law: DeviceLaw, spectrum: Single, total: Vector, scorer: Scorer
) -> Vector:
    """Information with the healthy error of the same device marginalised, shape (D,)."""
    seen, transform, errors = scorer.seen(law.patterns[0]), scorer.space.transform, scorer.errors
    for block in scorer.space.blocks:
        variance = errors.variance[block.columns]
        if not block.of_devices(kind.target) or block.accepted or not np.any(variance):
            continue
        own = scorer.space.terms.spectrum[:, block.columns]
        cross = np.einsum("bd,bd->d", seen.own, transform.by_band(spectrum * own))
        known = np.diag(errors.information)[block.columns] + 1.0 / np.maximum(variance, 1e-300)
        return np.maximum(total - cross**2 / known, 0.0)
    return total


def _spectra(law: DeviceLaw, values: Values, scorer: Scorer) -> tuple[Single, ...]:
    """Transformed steps of the courses; of those that never move, as if they began half-way."""
    spectra = scorer.space.courses.spectra(law, values)
    if any(np.any(one) for one in spectra):
        return spectra
    transform = scorer.space.transform
    begun = (np.arange(transform.rows) >= transform.rows // 2)[:, None]
    courses = law.course(values, scorer.space.signals)
    return tuple(transform.quick_spectrum(np.where(begun, one, 0.0)) for one in courses)


def _random(law: RandomLaw, scorer: Scorer) -> Vector:
    noise, transform = scorer.space.noise, scorer.space.transform
    seen = (law.patterns.T @ noise.modes) ** 2
    precision = noise.inverse_variance(transform) @ seen.T
    if not law.walk:
        precision = precision * transform.band_levels()[:, None]
    if law.together:
        precision = precision.sum(axis=1, keepdims=True)
    information = 0.5 * transform.count @ precision**2
    reading = float(np.sqrt(np.median(noise.reading)))
    with np.errstate(divide="ignore"):
        variances = SIGMAS / np.sqrt(information)
    return np.array([law.size(float(one), reading) for one in variances])
