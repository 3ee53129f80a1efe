"""Rows that are struck, nobody knows which: a mixture over rows of being struck and not."""

from collections.abc import Iterator

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise_laws import ReadingNoise
from orbitfb.diagnose.hypotheses.priors import MORE, VALUE_COST
from orbitfb.diagnose.hypotheses.row_sums import moving_root
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import EventLaw
from orbitfb.estimation.transform import Matrix

_SHARES = (0.003, 0.01, 0.03, 0.08, 0.2)
"""Shares of the rows that are struck."""

_STRENGTHS = (2.0, 4.0, 8.0, 16.0)
"""Standard deviations of a stroke on single readings, over their noise."""


def scan_events(kind: EffectKind, law: EventLaw, scorer: Scorer) -> list[Candidate]:
    """Find what is struck, and how often or how strongly."""
    if law.single:
        return [_tails(kind, scorer)]
    best: tuple[float, str, tuple[int, ...], Matrix, dict[str, float], Vector] | None = None
    count = 0
    response = scorer.space.signals.record.layout.response
    for name, members, shapes in _parts(law, response):
        count += 1
        pull, information = _rows(scorer, shapes)
        weigh = _jitter if law.often else _struck
        evidence, values, strength = weigh(kind, scorer, pull, information)
        if best is None or evidence > best[0]:
            best = (evidence, name, members, shapes, values, strength)
    if best is None:
        return []
    evidence, name, members, shapes, values, strength = best
    field = _field(scorer, shapes, strength)
    names = (name,) if members else ()
    gain = evidence - float(np.log(count)) - VALUE_COST
    return [Candidate(kind, members, names, values, gain, field=field)]


def _parts(law: EventLaw, response: Matrix) -> Iterator[tuple[str, tuple[int, ...], Matrix]]:
    """All at once, then every part for itself: its members, and the change by a strike."""
    yield "all", (), law.shapes
    drives = bool(np.any(law.moves))
    for name, members in law.parts.items():
        if drives:
            yield name, tuple(map(int, members)), law.moves[:, members] @ response[:, members].T
        else:
            shape = np.zeros_like(law.shapes)
            shape[:, members] = law.shapes[:, members]
            yield name, tuple(map(int, members)), shape


def _rows(scorer: Scorer, shapes: Matrix) -> tuple[Vector, Vector]:
    """Pull and information of a change at one row alone, for every step's row, shape (T,) each.

    Args:
        scorer: Of the record.
        shapes: Change of the reading, shape (N, n) [m].
    """
    space = scorer.space
    noise, rows = space.noise, space.transform.step_rows()
    shape = shapes[rows]
    following = np.vstack([scorer.late[1:], np.zeros_like(scorer.late[:1])])
    pull = np.einsum("tn,tn->t", shape, scorer.late - following)
    flat = 1.0 / np.sqrt(noise.ratio**2 + 4.0 * noise.ratio + 1e-12)
    weight = 2.0 * flat * (1.0 - moving_root(noise.ratio))
    information = ((shape @ noise.modes) ** 2) @ weight
    return pull, information


def _struck(
    kind: EffectKind, scorer: Scorer, pull: Vector, information: Vector
) -> tuple[float, dict[str, float], Vector]:
    """Strikes of strength one, with a probability: evidence, values, strength by step."""
    gain, against = pull - 0.5 * information, -pull - 0.5 * information
    best, share = -np.inf, 0.0
    for tried in _SHARES:
        # The same with the opposite sign: what noise of any shape gives to such a mixture.
        found = _mixture(gain, tried) - max(_mixture(against, tried), 0.0)
        if found > best:
            best, share = found, tried
    struck = np.log(share) + gain > np.log1p(-share)
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = share
    return best, values, struck.astype(float)


def _mixture(gain: Vector, share: float) -> float:
    return float(np.sum(np.logaddexp(np.log1p(-share), np.log(share) + np.clip(gain, -700, 700))))


def _jitter(
    kind: EffectKind, scorer: Scorer, pull: Vector, information: Vector
) -> tuple[float, dict[str, float], Vector]:
    """A normal strength at every row: evidence, values, strength by step."""
    best, variance = -np.inf, 0.0
    for values in scorer.space.courses.grid(kind):
        tried = values[kind.parameters[0].name] ** 2
        grown = 1.0 + information * tried
        found = float(np.sum(0.5 * pull**2 * tried / grown - 0.5 * np.log(grown)))
        if found > best:
            best, variance = found, tried
    strength = pull * variance / (1.0 + information * variance)
    return best, {kind.parameters[0].name: float(np.sqrt(variance))}, strength


def _field(scorer: Scorer, shapes: Matrix, strength: Vector) -> Matrix:
    """Spectrum of strikes at the rows of the steps."""
    transform = scorer.space.transform
    full = np.zeros_like(shapes)
    full[transform.step_rows()] = strength[:, None] * shapes[transform.step_rows()]
    return transform.spectrum(full)


def _tails(kind: EffectKind, scorer: Scorer) -> Candidate:
    """Single readings that are struck now and then: tails of the noise, of all BPMs or of some."""
    noise = ReadingNoise.of(scorer).values
    noise = noise / np.sqrt(np.mean(noise**2, axis=0))
    best: tuple[float, tuple[int, ...], float, float] = (-np.inf, (), 0.0, 0.0)
    for share in _SHARES:
        for strength in _STRENGTHS:
            level = 1.0 / (1.0 + share * strength**2)
            usual = -0.5 * (noise**2 / level + np.log(level))
            wide = level * (1.0 + strength**2)
            struck = -0.5 * (noise**2 / wide + np.log(wide))
            mixed = np.logaddexp(np.log1p(-share) + usual, np.log(share) + struck)
            gain = np.sum(mixed + 0.5 * noise**2, axis=0)
            cost = float(np.log(len(gain)))
            chosen = np.flatnonzero(gain > cost + MORE)
            some = float(np.sum(gain[chosen] - cost)) if len(chosen) else -np.inf
            every = float(np.sum(gain))
            places = () if every >= some else tuple(int(place) for place in chosen)
            if max(every, some) > best[0]:
                best = (max(every, some), places, share, strength)
    gain, places, share, strength = best
    values = {p.name: p.typical for p in kind.parameters}
    names = [p.name for p in kind.parameters]
    values[names[0]] = share
    reading = float(np.sqrt(np.median(np.diag(scorer.space.noise.white))))
    if len(names) > 1:
        values[names[1]] = strength * reading
    bpms = scorer.space.signals.record.layout.bpms
    told = tuple(bpms.label(place) for place in places)
    return Candidate(kind, places, told, values, gain - 2 * VALUE_COST, noisy=True)
