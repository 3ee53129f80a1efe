"""Plan for effects that somebody names, whose places and values are not known yet."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from orbitfb.core.errors import EstimationError
from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.proposals import Limits
from orbitfb.diagnose.experiments.search import plan
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.progress import Progress
from orbitfb.effects.kinds import EffectKind

_SEARCHED = 0.6
"""Share of the time that finding places and values takes."""


def plan_for(
    space: Workspace,
    kinds: Sequence[EffectKind],
    limits: Limits | None = None,
    against: EffectKind | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Find the experiment for effects whose places and values are not known yet.

    Args:
        space: The record.
        kinds: One effect that is to be seen better, or all that may compete: then the best one
            is split from the best other.
        limits: To be kept.
        against: Effect to be told apart from a single kind; None: its being there at all.
        seed: Of random levels.
        progress: Told what is done and which share of all.

    Raises:
        EstimationError: No effect leaves a trace, or the record is too short to be continued.
    """
    tell = progress or (lambda what, share: None)
    found = _found(space, kinds, lambda text: tell(text, _SEARCHED / 2))
    if not found and len(kinds) > 1:
        raise EstimationError(
            f"{space.signals.record.source}: no effect leaves a trace to plan from; name the "
            "effect that the experiment is to show (--for)"
        )
    first = Suspect.of(found[0]) if found else Suspect.typical(kinds[0], space.signals)
    rivals: list[Suspect] = []
    if against is not None:
        other = _found(space, [against], lambda text: tell(text, _SEARCHED))
        rivals = [Suspect.of(other[0]) if other else _in_its_place(against, first, space)]
    elif len(kinds) > 1:
        rivals = [Suspect.of(one) for one in found if one.kind.id != first.kind.id][:1]
    rest: Progress = lambda what, share: tell(what, _SEARCHED + (1.0 - _SEARCHED) * share)  # noqa: E731
    return plan(space, first, rivals, limits, seed, rest)


def _found(
    space: Workspace, kinds: Sequence[EffectKind], tell: Callable[[str], None]
) -> list[Candidate]:
    """What the record speaks for, the best first."""
    asked = {kind.id for kind in kinds}
    return [
        one
        for one in candidates_of(space, kinds, tell)
        if one.kind.id in asked and one.evidence > 0.0
    ]


def _in_its_place(kind: EffectKind, first: Suspect, space: Workspace) -> Suspect:
    """Another effect of typical size on the same devices, where it can be on them."""
    usual = Suspect.typical(kind, space.signals)
    alike = kind.target == first.kind.target and bool(first.places)
    return replace(usual, places=first.places) if alike else usual
