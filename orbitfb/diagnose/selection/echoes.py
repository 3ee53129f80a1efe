"""Candidates that say again what is said already, or no more than that noise is odd."""

from collections.abc import Sequence

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.estimation.priors import REMAINDER, SURE, SWALLOWED


def is_echo(one: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Whether it says again what is said of its BPMs.

    A BPM that averages, scales or delays does so to its noise as well, and what its law leaves
    wanders with the orbit: its noise, or what it reads, is not odd besides. And of a BPM whose
    noise is told to remember no law of its readings is: a feedback that acts on them makes the beam
    follow that noise, which looks like a law, and no floor has such a noise. One law is enough for
    the noise of a BPM: no floor has it, so that others would be as true. Readings are undone as
    they were read, so once only. And what a wave leaves, as the optics are a little wrong, is that
    wave, wherever another effect finds it.
    """
    if _is_same_wave(one, accepted):
        return True
    if one.kind.target != "bpm":
        return False
    if one.undone is not None and any(
        its.kind.target == "bpm" and set(its.places) & set(one.places) for its in accepted
    ):
        return True
    if one.places and set(one.names) <= coloured_names(accepted):
        return True
    if not (one.noisy or one.courseless):
        return False
    known = [
        set(its.places)
        for its in accepted
        if its.kind.target == "bpm" and (one.noisy or not its.noisy)
    ]
    return any(not places or (one.places and set(one.places) <= places) for places in known)


def _is_same_wave(one: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Whether another effect is accepted as a wave that the record cannot tell from this one's."""
    if one.cycles is None or one.field is None:
        return False
    waves = [its.cycles for its in accepted if its.cycles is not None and its.kind is not one.kind]
    return any(abs(its - one.cycles) * len(one.field) < 1.0 for its in waves)


def coloured_names(accepted: Sequence[Candidate]) -> set[str]:
    """Names of single BPMs whose noise is told to remember."""
    return {name for one in accepted if one.coloured for name in one.names}


def _is_odd_noise(one: Candidate, drawn: bool) -> bool:
    """Whether it says no more than that noise is odd, as any law that is not known yet makes it.

    Args:
        one: In question.
        drawn: Whether readings were drawn, which have nothing of such a law.
    """
    return one.noisy and (drawn or one.courseless)


def oddness(candidates: Sequence[Candidate], drawn: bool) -> float:
    """Evidence that noise is odd [nats]."""
    return max((one.evidence for one in candidates if _is_odd_noise(one, drawn)), default=0.0)


def last_resort(candidates: list[Candidate], before: float | None, drawn: bool) -> list[Candidate]:
    """Tell that the noise of a BPM is unlike the others' only where nothing else is told.

    Whatever a BPM does that is in no law adds to its noise. Where readings were drawn, so does any
    law that is not known yet: nothing of it is in those. A random course is no such law, and how
    much the ground moves leaves a BPM as odd as it is. A law of other devices that makes a BPM odd
    says more than that it is, but for what the floor may have of the law; one of BPMs, told to
    first order, or of readings that were drawn without it at least a share. And beside one of them
    that was accepted a BPM is odd that was as odd before: what such a law leaves is a share.

    Args:
        candidates: The best first.
        before: How odd a BPM was before any law was accepted [nats]; None: no law is yet.
        drawn: Whether readings were drawn.
    """
    odd = oddness(candidates, drawn)
    others = [one for one in candidates if not _is_odd_noise(one, drawn)]
    if before is not None:
        as_before = before > SURE and odd > before / SWALLOWED
        return candidates if as_before and not drawn else others
    told = [one for one in others if not (is_of_ground(one) or (drawn and one.courseless))]
    if not told:
        return candidates
    share = REMAINDER if drawn or told[0].kind.target == "bpm" else 1.0 / SWALLOWED
    return others if told[0].evidence >= max(SURE, share * odd) else candidates


def is_of_ground(one: Candidate) -> bool:
    """Whether it says only how much the ground moves."""
    return one.noisy and one.kind.target == "ring"
