"""What causes that are a little wrong leave to others, and what is none of it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.settled import settled
from orbitfb.estimation.priors import ALONE, ANYTHING, FIRST_ORDER, MISFIT, NEAREST, SURE


def enough_beside(told: float, space: Workspace) -> float:
    """Evidence from which one more candidate is sure [nats].

    Laws that are all a little wrong leave a share of their evidence to others.

    Args:
        told: Evidence of the causes beside it [nats].
        space: That it was tried on: its healthy errors are a little wrong, too.
    """
    return SURE + MISFIT * told + _misfit(space)


def is_another(one: Candidate, accepted: Sequence[Candidate], space: Workspace) -> bool:
    """Whether a candidate that has no more than causes may leave to others is none of it.

    Args:
        one: The best of a round.
        accepted: Causes.
        space: That it was tried on.
    """
    return _stands_out(one, accepted, space) or _elsewhere(one, accepted, space)


def _stands_out(one: Candidate, accepted: Sequence[Candidate], space: Workspace) -> bool:
    """Whether an error of few devices leaves nothing to the others.

    A law that is a little wrong is so at all its devices, and shows at all devices of others. An
    event shows nothing: whatever is wrong in one row shows as one at some place.
    """
    here = sum(its.evidence for its in accepted if _few(its, space))
    lasting = (bool(one.sources) or bool(one.columns)) and not one.onset and not one.noisy
    if not (lasting and _few(one, space)) or one.evidence < enough_beside(here, space):
        return False
    best, after = settled(one, space.trusting())
    rest = candidates_of(after, [one.kind])
    return not rest or rest[0].evidence < ALONE * best.evidence


def _elsewhere(one: Candidate, accepted: Sequence[Candidate], space: Workspace) -> bool:
    """Whether errors of all devices are sure where those at fault may do whatever they like.

    What a law of few devices leaves if it is a little wrong is at these, and near to them.
    """
    sources = [source for its in accepted for source in its.sources]
    few = all(its.sources and _few(its, space) for its in accepted)
    if not sources or not few or not one.scattered:
        return False
    patterns = np.hstack(
        [block[:, list(its.places)] for its in sources for block in its.law.patterns]
    )
    size = np.linalg.norm(patterns, axis=0)
    patterns = patterns[:, size > 0.0] / size[size > 0.0]
    noise = space.noise
    free = ANYTHING**2 * float(np.trace(noise.white)) / len(patterns) * patterns @ patterns.T
    rest = candidates_of(space.with_noise(replace(noise, white=noise.white + free)), [one.kind])
    return bool(rest) and rest[0].evidence > SURE + _misfit(space)


def _few(one: Candidate, space: Workspace) -> bool:
    """Whether it strikes at most half of the devices or places that it may strike.

    What may strike but one, as an energy, is of the whole ring.
    """
    most = len(space.signals.record.layout.bpms)
    strikes = min((source.law.patterns[0].shape[1] for source in one.sources), default=most)
    return 0 < 2 * len(one.places) <= min(strikes, most)


def _misfit(space: Workspace) -> float:
    """Evidence that other laws may find because healthy errors are told to first order [nats].

    What causes do that are not known yet is in the errors, too, but not in those that a healthy
    ring has: they count up to twice their limits.
    """
    rough = NEAREST if space.signals.record.layout.ring is None else FIRST_ORDER
    most = np.zeros(len(space.terms))
    for block in space.blocks:
        if not block.accepted:
            most[block.columns] = 2.0 * block.limit
    sizes = np.clip(space.priors.mean(space.errors.pull), -most, most)
    return 0.5 * rough**2 * float(sizes @ space.known.information @ sizes)
