"""Causes of a record: accepted candidates, joined where they are one, with their rivals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.selection.rounds import Round
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.priors import HIDDEN, MISFIT, REMAINDER, RIVAL, UNLISTED


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """A cause.

    Args:
        kind: Its effect.
        parts: Accepted candidates of the effect, the first one first.
        round: In which it was found.
        probability: Of its effect or one of its rivals [1].
        rivals: Ids of effects that the record cannot exclude in its place, likeliest first.
        chances: Probability of every effect in its place, by id [1].
    """

    kind: EffectKind
    parts: tuple[Candidate, ...]
    round: Round
    probability: float
    rivals: tuple[str, ...]
    chances: dict[str, float]

    @property
    def evidence(self) -> float:
        """Log evidence of all parts [nats]."""
        return sum(one.evidence for one in self.parts)

    @property
    def lacks(self) -> str:
        """What the record does not show of its law that makes it this one; empty: nothing."""
        return self.parts[0].lacks(self.round.space.signals)

    @property
    def names(self) -> tuple[str, ...]:
        """Places of all parts, each once; empty: the ring, or all devices."""
        if any(not one.places for one in self.parts):
            return ()
        return tuple(dict.fromkeys(name for one in self.parts for name in one.names))


def named(accepted: Sequence[Candidate], rounds: Sequence[Round]) -> list[Named]:
    """Join accepted candidates of one effect, and weigh each against what else it may be."""
    found: dict[str, list[tuple[Candidate, Round]]] = {}
    for one, its in zip(accepted, rounds, strict=False):
        found.setdefault(one.kind.id, []).append((one, its))
    causes = []
    for parts in found.values():
        first, its = parts[0]
        chances = probabilities(its.candidates)
        rivals = [
            name
            for name, chance in sorted(chances.items(), key=lambda two: -two[1])
            if name not in (first.kind.id, "") and chance > RIVAL
        ]
        candidates = tuple(one for one, _ in parts)
        within = sum(chances[name] for name in (first.kind.id, *rivals))
        within *= listed_chance(sum(one.evidence for one in candidates))
        causes.append(Named(first.kind, candidates, its, within, tuple(rivals), chances))
    return causes


def listed_chance(evidence: float) -> float:
    """Probability that the library has the law of a cause, though an unlisted one may look like it.

    What an unlisted law does has a share f in common with the best effect of the library; any
    share between 0 and 1 is as likely. Of a cause of E nats it leaves E (1 / f - 1), which nothing
    shows below R nats: if f is more than E / (E + R), with a probability of R / (E + R).

    Args:
        evidence: Of the cause, E [nats].
    """
    shown = HIDDEN + REMAINDER * evidence
    return 1.0 / (1.0 + UNLISTED * shown / (evidence + shown))


def probabilities(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Probability of every effect to be the one that explains most, and of none ("").

    Evidence is that of models that are all a little wrong: differences count in units of a share
    of what the best one explains. Free elements of the response take what any law of their device
    does: they are no rival of a law that says how.
    """
    best: dict[str, float] = {"": 0.0}
    free = bool(candidates) and candidates[0].kind.elemental
    for one in candidates:
        if one.kind.elemental and not free:
            continue
        best[one.kind.id] = max(best.get(one.kind.id, -np.inf), one.evidence)
    top = max(best.values())
    unit = 1.0 + MISFIT * max(top, 0.0)
    weights = {name: float(np.exp((value - top) / unit)) for name, value in best.items()}
    weights[""] = float(np.exp(-top))  # that there is nothing is no model that is a little wrong
    total = sum(weights.values())
    return {name: weight / total for name, weight in weights.items()}
