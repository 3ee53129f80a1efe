"""The tournament: all hypotheses, the best accepted, and again."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.hypotheses.device_laws import scan_devices, sparse_sizes
from orbitfb.diagnose.hypotheses.events import scan_events
from orbitfb.diagnose.hypotheses.fields import scan_field
from orbitfb.diagnose.hypotheses.healthy import scan_errors
from orbitfb.diagnose.hypotheses.lines import scan_lines
from orbitfb.diagnose.hypotheses.pairs import scan_pairs
from orbitfb.diagnose.hypotheses.priors import ROUNDS, SURE
from orbitfb.diagnose.hypotheses.random_laws import scan_random
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, EventLaw, FieldLaw, Law, PairLaw


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round: every candidate, the best first, and the workspace that they were tried on."""

    space: Workspace
    candidates: tuple[Candidate, ...]


def tournament(
    space: Workspace,
    kinds: Sequence[EffectKind],
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[list[Candidate], list[Round]]:
    """Accept the best hypothesis while one is sure.

    Args:
        space: Of the record.
        kinds: Effects that the record can show.
        tell: Is told the effect that is tried, and what it takes.

    Returns:
        The accepted candidates in order, and all rounds, the last one without a sure candidate.
    """
    accepted: list[Candidate] = []
    rounds: list[Round] = []
    while True:
        told = {one.kind.id for one in accepted if one.noisy}
        left = [kind for kind in kinds if kind.id not in told]
        candidates = candidates_of(space, left, tell)
        rounds.append(Round(space, tuple(candidates)))
        for one in candidates[:6]:
            tell("top " + one.describe())
        if len(accepted) == ROUNDS or not candidates or candidates[0].evidence < SURE:
            return accepted, rounds
        accepted.append(candidates[0])
        space = candidates[0].accepted(space)


def candidates_of(
    space: Workspace, kinds: Sequence[EffectKind], tell: Callable[[str], None]
) -> list[Candidate]:
    """Try every hypothesis on what is left, the best first."""
    scorer = Scorer.of(space)
    began = time.process_time()
    found = list(scan_errors(scorer))
    tell(f"errors {time.process_time() - began:.2f} s")
    for kind in kinds:
        began = time.process_time()
        for law in kind.laws(space.signals):
            found += _scan(kind, law, scorer)
        tell(f"{kind.id} {time.process_time() - began:.2f} s")
    return strongest(found)


def _scan(kind: EffectKind, law: Law, scorer: Scorer) -> list[Candidate]:
    """Scan a law by its form."""
    if isinstance(law, DeviceLaw):
        if law.periodic:
            return scan_lines(kind, law, scorer)
        return [*scan_devices(kind, law, scorer), *sparse_sizes(kind, law, scorer)]
    if isinstance(law, PairLaw):
        return scan_pairs(kind, law, scorer)
    if isinstance(law, FieldLaw):
        return scan_field(kind, law, scorer)
    if isinstance(law, EventLaw):
        return scan_events(kind, law, scorer)
    return scan_random(kind, law, scorer)
