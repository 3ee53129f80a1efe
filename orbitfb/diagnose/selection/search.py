"""The search for causes: over ground that may be uneven, and over even ground."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise.shared import shared_noise
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.constancy import varying
from orbitfb.diagnose.selection.rounds import Round, tournament
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.priors import SURE


def search(
    space: Workspace,
    kinds: Sequence[EffectKind],
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[list[Candidate], list[Round]]:
    """Search for causes, and where none is found once more as if all of the ground moved alike.

    Ground that may move more at any place, or in any shape, takes up most of a weak cause that is
    slow. Even ground does not, but is not what every ring stands on: where it is surely uneven this
    ends, and else a cause has to say more than that it is.

    Args:
        space: Of the record.
        kinds: Effects that the record can show.
        tell: Is told the effect that is tried, and what it takes.

    Returns:
        The accepted candidates in order, and all rounds, as `tournament` does. What is unknown in
        the last one may be that a cause comes and goes, or that BPMs have noise in common.
    """
    accepted, rounds = _over_either(space, kinds, tell)
    last = rounds[-1]
    more = [*varying(accepted, last.space), shared_noise(last.space)]
    free = sorted([*last.free, *more], key=lambda one: -one.evidence)
    return accepted, [*rounds[:-1], replace(last, free=tuple(free))]


def _over_either(
    space: Workspace, kinds: Sequence[EffectKind], tell: Callable[[str], None]
) -> tuple[list[Candidate], list[Round]]:
    """Search over ground that may be uneven, and then over even ground."""
    accepted, rounds = tournament(space, kinds, tell)
    if accepted or rounds[-1].unknown or space.reference is not None:
        return accepted, rounds
    even = rounds[-1].space.even()
    if even.unevenness() > SURE:
        return accepted, rounds
    over_even = tournament(even, kinds, tell)
    return over_even if over_even[0] or over_even[1][-1].unknown else (accepted, rounds)
