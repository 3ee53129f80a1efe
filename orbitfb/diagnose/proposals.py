"""Which of all that a scan proposes deserves to be fitted."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.budget import SCAN_SHARE, Budget
from orbitfb.diagnose.candidate import FIRST_ONSET, Candidate
from orbitfb.diagnose.entry import net
from orbitfb.diagnose.noise_levels import level_candidates
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.randomness import noise_candidates
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

FINALISTS = 10
"""Candidates that are fitted exactly, beside those without a size."""
_KINDS = 7
"""Kinds of which at least the best one is."""
_LEAST_FINALISTS = 3
_RIVAL = 0.2
"""Share of what the best of a kind promises from which one that was always there is fitted too."""


def propose(
    bench: Bench,
    kinds: Sequence[EffectKind],
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> list[Candidate]:
    """List the candidates that deserve a fit, best first.

    Args:
        bench: The record under the causes accepted so far.
        kinds: Those that the record can show.
        progress: Told what is done and which share of all.
        budget: Time for it; kinds that are not reached are told to it. None: all there is.
    """
    scanner = Scanner(bench)
    found: list[Candidate] = []
    for index, kind in enumerate(kinds):
        if budget is not None and budget.over(SCAN_SHARE) and not bench.causes:
            budget.unseen += [kind.id] if kind.id not in budget.unseen else []
            continue
        if budget is not None and budget.over():
            budget.leave("further causes were looked for among some effects only")
            break
        if isinstance(kind, NoiseKind):
            found += noise_candidates(bench, kind)
        elif isinstance(kind, LatentKind):
            found += latent_candidates(bench, kind)
        else:
            found += scanner.candidates(kind)
        if progress is not None:
            progress(kind.id, (index + 1) / len(kinds))
    found += level_candidates(bench, kinds)
    found += [*_scaled_noise(found, kinds)]
    found = _without_early(found)
    found.sort(key=net, reverse=True)
    worth = sum(net(candidate) > 0.0 for candidate in found)
    return _chosen(found[: max(worth, _LEAST_FINALISTS)])


def _without_early(found: Sequence[Candidate]) -> list[Candidate]:
    """Leave out what begins with the record, where it is there as what was always there too.

    From which of its first rows on an effect acts is looked for when it is fitted.
    """
    always = {(one.cause.kind.id, one.cause.places) for one in found if not one.cause.onset}
    return [
        one
        for one in found
        if not 0 < one.cause.onset < 2 * FIRST_ONSET
        or (one.cause.kind.id, one.cause.places) not in always
    ]


def _scaled_noise(found: Sequence[Candidate], kinds: Sequence[EffectKind]) -> Iterator[Candidate]:
    """Try what scales readings, noise and all, wherever the noise has another level.

    Where the orbit hardly moves the noise alone shows it: only the fit tells the two apart.
    """
    for kind in kinds:
        if isinstance(kind, SensorKind) and kind.scales and kind.linear is not None:
            for one in found:
                if one.cause.kind.id == "noise-level" and one.cause.places:
                    size = one.cause.values["factor"] - 1.0
                    cause = replace(one.cause, kind=kind, values={kind.linear: size})
                    yield replace(one, cause=cause)


def _chosen(found: Sequence[Candidate]) -> list[Candidate]:
    """Take the best of the best kinds, every one without a size, and the best of the rest.

    One that begins late is there with the one that was always there: that is the simpler law,
    and the scan tells the two apart roughly. So it does for one with a free first step, and for
    one device and a group of them.
    """
    firsts: dict[str, Candidate] = {}
    twins: dict[tuple[str, bool, bool, bool], Candidate] = {}
    for candidate in found:
        cause = candidate.cause
        first = firsts.setdefault(cause.kind.id, candidate)
        if net(candidate) > _RIVAL * net(first):
            group = len(cause.places) > 1
            twins.setdefault((cause.kind.id, cause.onset > 0, cause.free, group), candidate)
    kept = [*firsts.values()][:_KINDS]
    for (kind, late, free, group), twin in twins.items():
        other = group != (len(firsts[kind].cause.places) > 1)
        if (free or not late or other) and twin not in kept:
            kept.append(twin)
    kept += [one for one in firsts.values() if not one.cause.kind.parameters and one not in kept]
    kept += [one for one in found if one not in kept][: max(FINALISTS - len(kept), 0)]
    return sorted(kept, key=net, reverse=True)
