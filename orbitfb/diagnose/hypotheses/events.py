"""Rows that are struck, nobody knows which: a mixture over rows of being struck and not."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise.tails import scan_tails
from orbitfb.diagnose.hypotheses.row_sums import Rows
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import EventLaw
from orbitfb.estimation.maxima import nearby
from orbitfb.estimation.priors import (
    KNOWN_TO,
    STRUCK_FINE,
    STRUCK_RUN,
    STRUCK_SHARES,
    VALUE_COST,
)
from orbitfb.estimation.runs import evidence_of_runs, likeliest_runs
from orbitfb.estimation.transform import Indices, Matrix

_ONE_SIDED = float(np.sqrt(3.0))
"""Largest mean over the standard deviation of what is only early, and the less often the more [1]:
that of a uniform distribution that begins at zero."""


def scan_events(kind: EffectKind, law: EventLaw, scorer: Scorer) -> list[Candidate]:
    """Find what is struck, and how often or how strongly."""
    if law.single:
        return [scan_tails(kind, scorer)]
    strikes = _Strikes.of(law, scorer)
    parts = {"": np.arange(strikes.moves.shape[1]), **law.parts}

    def weigh(name: str) -> float:
        known = strikes.rows(parts[name])
        return _jitter(kind, scorer, *known)[0] if law.often else _struck(*known)

    return [_told(kind, law, scorer, max(parts, key=weigh), strikes)]


def _told(
    kind: EffectKind, law: EventLaw, scorer: Scorer, name: str, strikes: "_Strikes"
) -> Candidate:
    """What strikes some devices together, and again over the floor that it leaves.

    Where many rows are struck the floor has some of it, and the weaker strikes do not show.

    Args:
        kind: The effect.
        law: Of it.
        scorer: Of what is left to explain.
        name: Of the devices; empty: all.
        strikes: Of all devices, over that floor.
    """
    members = law.parts[name] if name else np.arange(strikes.moves.shape[1])
    if law.often:
        values, field, chosen, deviations = _about_mean(kind, scorer, strikes, members)
    else:
        values, field, chosen, struck = _in_runs(kind, scorer, strikes, members)
        deviations = {kind.parameters[0].name: 1.0 / float(np.sqrt(struck + 1.0 / KNOWN_TO**2))}
    cost = chosen + float(np.log(1 + len(law.parts))) + VALUE_COST

    def again(after: Workspace) -> Candidate:
        lower = Scorer.of(over(scorer.space, after))
        return _told(kind, law, lower, name, _Strikes.of(law, lower))

    return Candidate(
        kind, tuple(map(int, members)) if name else (), (name,) if name else (), values,
        scorer.likelihood(field) - cost, field=field, cost=cost, again=again,
        deviations=deviations,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Strikes:
    """Changes of the readings at single rows, as sums over devices: correctors, or the BPMs.

    Args:
        moves: Of every device at every row, shape (N, D).
        patterns: What one unit of it does to the readings, shape (n, D) [m].
        along: Pull of a unit at the row of every step, shape (T, D).
        gram: Information of units at one row, shape (D, D).
        apart: Of units at one row with those at the row before, shape (D, D).
        every: Rows of the steps, shape (T,).
    """

    moves: Matrix
    patterns: Matrix
    along: Matrix
    gram: Matrix
    apart: Matrix
    every: Indices

    @classmethod
    def of(cls, law: EventLaw, scorer: Scorer) -> "_Strikes":
        """Look along the devices that a law strikes."""
        space = scorer.space
        response = space.signals.record.layout.response
        drives = bool(np.any(law.moves))
        moves, patterns = (
            (law.moves, response) if drives else (law.shapes, np.eye(law.shapes.shape[1]))
        )
        ratio = space.noise.ratio
        # Mean of λ/(q + λ) over the frequencies, and of its product with cos ω, λ = 2 − 2 cos ω:
        # of a mode that does not walk all is noise, from row to row for itself.
        walks = np.sqrt(ratio / (ratio + 4.0))
        weight = 1.0 - walks
        beside = -walks * 0.5 * (ratio + 2.0 - np.sqrt(ratio * (ratio + 4.0)))
        seen = patterns.T @ space.noise.modes
        return cls(
            moves, patterns, _single_rows(scorer.rows) @ patterns, (seen * weight) @ seen.T,
            (seen * beside) @ seen.T, space.transform.step_rows(),
        )  # fmt: skip

    def less(self, field: Matrix, scorer: Scorer) -> "_Strikes":
        """The same where a field, shape (T, n) [m], is taken off what is left."""
        space = scorer.space
        rows = Rows.of(scorer.left - field, space.noise, space.transform)
        return replace(self, along=_single_rows(rows) @ self.patterns)

    def rows(self, members: Indices) -> tuple[Vector, Vector]:
        """Pull and information of some devices struck at one row alone, shape (T,) each."""
        moves = self.moves[np.ix_(self.every, members)]
        pull = np.einsum("td,td->t", moves, self.along[:, members])
        inner = moves @ self.gram[np.ix_(members, members)]
        return pull, np.einsum("td,td->t", inner, moves)

    def following(self, before: "_Strikes", members: Indices) -> Vector:
        """Information that strikes share with others, of the row before, shape (T,).

        Args:
            before: The others.
            members: Devices that are struck together.
        """
        inner = before.moves[np.ix_(self.every - 1, members)] @ self.apart[np.ix_(members, members)]
        return np.einsum("td,td->t", inner, self.moves[np.ix_(self.every, members)])

    def shapes(self, members: Indices) -> Matrix:
        """Change of the readings at every row by some devices, shape (N, n) [m]."""
        return self.moves[:, members] @ self.patterns[:, members].T

    def later(self, before: "_Strikes", starts: Mask) -> "_Strikes":
        """Strikes after one more than another has before them: what is held is older by a row.

        Args:
            before: The others.
            starts: Whether a row begins a stretch, shape (N,).
        """
        held = np.roll(before.moves, 1, axis=0)
        held[starts] = 0.0
        return replace(self, moves=self.moves + held)


def _single_rows(rows: Rows) -> Matrix:
    """How what is left pulls at readings of single rows, shape (T, n) [1/m]."""
    return rows.late - np.vstack([rows.late[1:], np.zeros_like(rows.late[:1])])


def _struck(pull: Vector, information: Vector) -> float:
    """Log evidence of strikes of strength one, every row for itself."""
    gain, against = pull - 0.5 * information, -pull - 0.5 * information
    # The same with the opposite sign: what noise of any shape gives to such a mixture.
    found, chance = (
        max(_mixture(one, share) for share in STRUCK_SHARES) for one in (gain, against)
    )
    return found - max(chance, 0.0)


def _mixture(gain: Vector, share: float) -> float:
    return float(np.sum(np.logaddexp(np.log1p(-share), np.log(share) + np.clip(gain, -700, 700))))


def _in_runs(
    kind: EffectKind, scorer: Scorer, strikes: _Strikes, members: Indices
) -> tuple[dict[str, float], Matrix, float, int]:
    """Strikes of strength one that may follow each other: values, what they add, cost and count.

    The cost of choosing the rows is that of their chain [nats], and what noise of any shape gives.

    Args:
        kind: The effect.
        scorer: Of what is left to explain.
        strikes: Of all devices.
        members: Devices that are struck together.
    """
    starts = scorer.space.signals.record.starts
    runs = [strikes]
    for _ in range(STRUCK_RUN - 1):
        runs.append(strikes.later(runs[-1], starts))
    known = [one.rows(members) for one in runs]
    pull, information = (np.stack(its) for its in zip(*known, strict=True))
    for number in range(1, len(runs)):
        information[number] += 2.0 * runs[number].following(runs[number - 1], members)
    gains = pull - 0.5 * information
    shares = np.geomspace(min(STRUCK_SHARES), max(STRUCK_SHARES), STRUCK_FINE)
    found = evidence_of_runs(gains, shares)
    share = float(shares[np.argmax(found)])
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = share
    length = likeliest_runs(gains, share)
    field = np.zeros_like(scorer.space.plain)
    for run, one in enumerate(runs, 1):
        if np.any(length == run):
            field += _field(scorer, one.shapes(members), (length == run).astype(float))
    # The opposite sign, beside those that are found: what noise of any shape gives to such a chain.
    left = strikes.less(field, scorer)
    opposite = np.stack([replace(one, along=left.along).rows(members)[0] for one in runs])
    chance = evidence_of_runs(-opposite - 0.5 * information, shares)
    struck = np.count_nonzero(length)
    cost = -struck * np.log(share) - (len(length) - struck) * np.log1p(-share)
    return values, field, float(cost + max(chance.max(), 0.0)), int(struck)


def _about_mean(
    kind: EffectKind, scorer: Scorer, strikes: _Strikes, members: Indices
) -> tuple[dict[str, float], Matrix, float, dict[str, float]]:
    """A normal strength at every row, about a mean: values, what they add, cost, deviations.

    The mean is of the size of the scatter: what is early by chance is early on average, unless it
    is late as often. With a larger one it is a delay.

    Args:
        kind: The effect; its parameters are the rms of the strength and its mean.
        scorer: Of what is left to explain.
        strikes: Of all devices.
        members: Devices that are struck together.
    """
    rms, mean = (one.name for one in kind.parameters)
    pull, information = strikes.rows(members)
    _, spread, strength, cost = _jitter(kind, scorer, pull, information)
    always = _field(scorer, strikes.shapes(members), np.ones(len(pull)))
    along, known = (float(one.item()) for one in scorer.evaluate([always]))
    # Scatter hides the mean, too: more, where few rows say most of it.
    counts = information / max(float(np.sum(information)), 1e-300)
    share = 1.0 / (1.0 + known * spread**2 * float(np.sum(counts**2)))
    grown = 1.0 + share * known * spread**2
    size, doubt = share * along * spread**2 / grown, spread / float(np.sqrt(grown))
    pull, _ = strikes.less(size * always, scorer).rows(members)
    _, rest, beside, more = _jitter(kind, scorer, pull, information)
    if abs(size) > _ONE_SIDED * rest:
        size = 0.0
    else:
        chosen = 0.5 * float(np.log(grown)) + 0.5 * size**2 / max(spread, 1e-300) ** 2
        spread, strength, cost = rest, beside, more + chosen
    field = size * always + _field(scorer, strikes.shapes(members), strength)
    seen = information / (information + 1.0 / max(spread, 1e-300) ** 2)
    about = spread**2 / float(np.sqrt(2.0 * np.sum(seen**2) + 1.0 / KNOWN_TO**2))
    whole = float(np.hypot(spread, size))
    deviations = {}
    if whole:
        deviations[rms] = float(np.hypot(about, size * doubt)) / whole**2
    if size:
        deviations[mean] = doubt / abs(size)
    return {rms: whole, mean: size}, field, cost, deviations


def _jitter(
    kind: EffectKind, scorer: Scorer, pull: Vector, information: Vector
) -> tuple[float, float, Vector, float]:
    """A normal strength at every row: evidence, its rms, strength by step, and its cost [nats]."""

    def worth(rms: float) -> float:
        grown = 1.0 + information * rms**2
        return float(np.sum(0.5 * (pull * rms) ** 2 / grown - 0.5 * np.log(grown)))

    grid = sorted(values[kind.parameters[0].name] for values in scorer.space.courses.grid(kind))
    rms, _ = nearby(worth, max(grid, key=worth), float(np.max(np.divide(grid[1:], grid[:-1]))))
    best, variance = worth(rms), rms**2
    strength = pull * variance / (1.0 + information * variance)
    apart = strength**2 / variance if variance else np.zeros_like(strength)
    cost = 0.5 * float(np.sum(apart + np.log1p(information * variance)))
    return best, rms, strength, cost


def _field(scorer: Scorer, shapes: Matrix, strength: Vector) -> Matrix:
    """Spectrum of strikes at the rows of the steps."""
    transform = scorer.space.transform
    full = np.zeros_like(shapes)
    full[transform.step_rows()] = strength[:, None] * shapes[transform.step_rows()]
    return transform.spectrum(full)
