"""Slices of the record that show a cause: its course, the answer by age, the likeness of laws."""

from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.result.blocks import Fingerprint, Identifiability, LagProfile
from orbitfb.diagnose.result.values import numbers, rows
from orbitfb.estimation.priors import ALIKE
from orbitfb.estimation.transform import Matrix

_BINS = 15
"""Points of a fingerprint."""

_LEAST = 30
"""Readings of a point at least: its error is then known to an eighth."""

_LAGS = 6
"""Ages of a change that are told: 0.6 s at 10 Hz."""


def fingerprints(its: Explained, causes: Sequence[Named]) -> tuple[Fingerprint, ...]:
    """Compare what the first cause adds to the readings with what they show.

    Every step of every reading is sorted by the step that the cause adds there; of a law that is
    right the mean of what the model without it leaves lies on the diagonal.
    """
    transform = its.space.transform
    for cause, field in zip(causes, its.fields, strict=True):
        if field is None:
            continue
        expected = 1e6 * transform.turn(field).ravel()
        shown = 1e6 * transform.turn(its.left + field).ravel()
        struck = np.abs(expected) > 0.05 * np.max(np.abs(expected))
        if struck.sum() < _LEAST:
            return ()
        edges = np.quantile(expected[struck], np.linspace(0.0, 1.0, _BINS + 1)[1:-1])
        place = np.searchsorted(edges, expected[struck])
        count = np.bincount(place, minlength=_BINS)
        kept = count >= _LEAST
        mean, seen, square = (
            np.bincount(place, values, minlength=_BINS)[kept] / count[kept]
            for values in (expected[struck], shown[struck], shown[struck] ** 2)
        )
        error = np.sqrt(np.maximum(square - seen**2, 0.0) / count[kept])
        return (
            Fingerprint(
                title=f"Steps of the readings by {cause.kind.title}",
                x_label="step that the cause adds to a reading [µm]",
                y_label="step that the readings show beyond the other causes [µm]",
                x=numbers(mean), measured=numbers(seen), nominal=numbers(np.zeros(len(mean))),
                refit=numbers(mean), error=numbers(error),
            ),
        )  # fmt: skip
    return ()


def lag_profile(its: Explained) -> LagProfile:
    """Regress what is left on the orbit that changes of the setpoints some rows ago should make.

    A model that is right leaves nothing at any age.
    """
    space = its.space
    transform, noise = space.transform, its.noise
    spectrum = transform.quick_spectrum(space.signals.currents)
    steps = transform.turn(spectrum).astype(np.float32)
    response = space.signals.record.layout.response
    modes = response.T @ noise.modes
    weight = 1.0 / np.sqrt(noise.variance(transform))
    late: list[Matrix] = []
    for lag in range(_LAGS):
        moved = np.zeros_like(steps)
        for part in transform.pieces:
            last = max(part.stop - lag, part.start)
            moved[part.start + lag : part.stop] = steps[part.start : last]
        late.append((transform.turn(moved) @ modes) * weight)
    before, after = ((one @ noise.modes) * weight for one in (its.nominal, its.left))
    normal = np.array([[np.sum(a * b) for b in late] for a in late])
    inverse = np.linalg.pinv(normal, hermitian=True, rcond=1e-10)
    slope = inverse @ np.array([np.sum(one * before) for one in late])
    refit = inverse @ np.array([np.sum(one * after) for one in late])
    reach = 1.645 * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return LagProfile(
        lags=tuple(range(_LAGS)),
        slope=numbers(slope), low=numbers(slope - reach), high=numbers(slope + reach),
        refit=numbers(refit) if its.counts else (),
    )  # fmt: skip


def likeness(candidates: Sequence[Candidate], scorer: Scorer) -> Identifiability | None:
    """Cosines of what the best effects add to the record, one of each.

    Args:
        candidates: Of the first round, the best first.
        scorer: Of that round.
    """
    best: dict[str, Candidate] = {}
    for one in candidates:
        best.setdefault(one.kind.id, one)
    found = {name: _field(one, scorer.space) for name, one in best.items() if one.evidence > 0.0}
    fields = {name: field for name, field in found.items() if field is not None}
    if len(fields) < 2:
        return None
    _, information = scorer.evaluate(list(fields.values()))
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    cosine = np.clip(information / np.outer(size, size), -1.0, 1.0)
    names = tuple(fields)
    alike = [
        f"{names[a]} and {names[b]} change this record alike (cosine {cosine[a, b]:.3f})."
        for a in range(len(names))
        for b in range(a + 1, len(names))
        if abs(cosine[a, b]) > ALIKE
    ]
    return Identifiability(effects=names, cosine=rows(cosine), degenerate=tuple(alike))


def _field(one: Candidate, space: Workspace) -> Matrix | None:
    """What a candidate adds to the readings, (T, n) [m]; None of what is random, or everywhere."""
    if one.field is not None or not one.columns:
        return one.field
    sizes = np.zeros(len(space.terms))
    sizes[list(one.columns)] = one.sizes
    return space.terms.contribution(sizes)
