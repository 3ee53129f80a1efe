"""Laws that begin in the middle of a record.

They are weighed from every tenth row on, device by device and group by group. From the best row on
their devices are sought as those of a law that was always there, and the best set row by row. Laws
whose course is a constant are in `jumps`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.jumps import of_jumps
from orbitfb.diagnose.hypotheses.onsets.every import every, shown_together
from orbitfb.diagnose.hypotheses.onsets.exact import (
    HOPEFUL,
    Begin,
    always,
    exactly,
    kicking,
    kicks_of,
)
from orbitfb.diagnose.hypotheses.ranking import (
    Ranked,
    any_size,
    cost_of,
    of_device,
    scales,
    sign,
    stood_in,
    worths_of,
)
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, OwnValues, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.priors import (
    ONSET_MARGIN,
    ONSET_SIGN,
    ONSETS_EVERY,
)
from orbitfb.estimation.transform import Indices, Matrix


def scan_late(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """Find the devices of a law that begin late together with the most evidence.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best ones, if any are worth something.
    """
    if not kind.sudden:
        return []
    # Where nothing shows over the whole record a first kick may still tell, or the change of what
    # the healthy error of the same devices stands in for.
    tried: Sequence[OwnValues] = rank.beginning
    if not tried and (law.standing or (kind.linear is not None and scorer.is_usual(kind))):
        tried = list(rank.grid[:1])
    found = []
    for values in tried:
        begin = _begins(kind, law, scorer, values)
        if begin is None:
            continue
        cost = cost_of(kind, begin.values, scorer)
        if begin.together > cost and scorer.is_usual(kind):
            whole = Candidate(kind, (), (), begin.values, begin.together - cost, onset=begin.about)
            its = kind, law, scorer, begin.values, begin.about, cost
            found.append(replace(whole, finer=partial(every, *its)))
        if begin.evidence <= 0.0:
            continue
        begin = replace(begin, around=rank.around(begin.values, begin.places))
        if law.standing:
            found.append(kicking(kind, law, scorer, begin, cost))
        else:
            found += _from(kind, law, scorer, begin, cost)
    return found


def _begins(kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: OwnValues) -> Begin | None:
    """The best device, or group, that begins late; None: nothing is as if one did.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        values: Of the parameters; where they are of every device's own no group has them.
    """
    spectra = scorer.space.courses.spectra(law, values)
    if not any(np.any(one) for one in spectra):
        return None
    count = len(law.names)
    error = scorer.own_error(kind)
    pull, information = scorer.apart(law, values, error)
    shown = sign(pull, information)
    kicks = kicks_of(law, scorer, spectra) if law.standing else None
    if kicks is not None:
        shown = shown + np.maximum(kicks.max(axis=0) - np.log(len(kicks)), 0.0)
    jumps = _jumps(law, scorer, values)
    if jumps is not None:
        shown = np.maximum(shown, sign(*jumps).max(axis=0) - np.log(len(jumps[0])))
    usual = scorer.is_usual(kind)
    usual = usual or (not scales(kind) and stood_in(kind, law, values, scorer))
    one_each = any(np.ndim(value) for value in values.values())
    sets = [] if one_each else _hopeful_sets(law, scorer, pull, spectra, every=usual)
    if usual:
        hopeful = np.arange(count)
    else:
        hopeful = np.flatnonzero(shown > ONSET_SIGN)
        hopeful = hopeful[np.argsort(-shown[hopeful], kind="stable")[:HOPEFUL]]
        hopeful = np.unique(np.concatenate([hopeful, *sets]))
    if not len(hopeful):
        return None
    error = scorer.own_error(kind, hopeful)
    steps = [
        np.broadcast_to(turned, (len(turned), count))
        for turned in (scorer.space.transform.turn(one) for one in spectra)
    ]
    onsets = np.arange(0, len(steps[0]), ONSETS_EVERY)
    among = [np.searchsorted(hopeful, its) for its in sets]
    parts = [
        scorer.rows.since(pattern[:, hopeful], own[:, hopeful], onsets, error, among)
        for pattern, own in zip(law.patterns, steps, strict=True)
    ]
    # Of a law of one size, too: healthy errors stand in for a part of what is left of it.
    pulled, informed = (np.sum(its, axis=0) for its in zip(*parts, strict=True))
    gain = any_size(pulled, informed)
    jumped = None
    if jumps is not None:
        alone = slice(len(hopeful))
        jumped = _jumped(pulled[:, alone], informed[:, alone], jumps, hopeful, onsets)
        gain[:, alone] = np.maximum(gain[:, alone], np.maximum.reduceat(jumped, onsets, axis=0))
    if kicks is not None:
        gain = gain + np.maximum.reduceat(kicks[:, hopeful], onsets, axis=0)
    outside = (onsets < ONSET_MARGIN) | (onsets > len(scorer.space.transform) - ONSET_MARGIN)
    gain[outside] = -np.inf
    onset, place = map(int, np.unravel_index(int(np.argmax(gain)), gain.shape))
    single = place < len(hopeful)
    places = hopeful[place : place + 1] if single else sets[place - len(hopeful)]
    cost = np.log(count + len(law.groups)) + np.log(len(onsets))
    row = int(onsets[onset])
    together = shown_together(gain[:, : len(hopeful)])
    at_once = kicks[:, hopeful] if kicks is not None else jumped
    if at_once is not None and single:  # the kick tells the row
        row += int(np.argmax(at_once[row : row + ONSETS_EVERY, place]))
    rows = scorer.space.transform.step_rows()
    told = tuple(map(int, places)) if single or len(places) < count else ()
    best = np.argsort(-gain[:, place], kind="stable")
    others = tuple(map(int, rows[onsets[best[np.isfinite(gain[best, place])]]]))
    most = int(np.argmax(together))
    return Begin(
        float(gain[onset, place] - cost), told, int(rows[row]), of_device(values, int(places[0])),
        others, float(together[most]), int(rows[onsets[most]]),
    )  # fmt: skip


def _jumps(law: DeviceLaw, scorer: Scorer, values: OwnValues) -> tuple[Matrix, Matrix] | None:
    """Pull and information of what each device adds at once, if it begins at a step, (T, D).

    None of a law that does not know it.
    """
    if law.first is None:
        return None
    reached = law.first(cast(Values, values), scorer.space.signals)
    reached = reached[scorer.space.transform.step_rows()]
    pull: Matrix | float = 0.0
    information: Matrix | float = 0.0
    for pattern in law.patterns:
        along, own = of_jumps(pattern, scorer)
        pull, information = pull + reached * along, information + reached**2 * own
    return np.asarray(pull), np.asarray(information)


def _jumped(
    pull: Matrix,
    information: Matrix,
    jumps: tuple[Matrix, Matrix],
    devices: Indices,
    onsets: Indices,
) -> Matrix:
    """Log evidence of devices that begin with a jump, at every step, shape (T, k).

    Args:
        pull: Of what follows from the onset on, shape (O, k).
        information: The same.
        jumps: Pull and information of the jump at every step, of all devices, shape (T, D).
        devices: Numbers of the k.
        onsets: Steps, shape (O,).
    """
    within = np.searchsorted(onsets, np.arange(len(jumps[0])), side="right") - 1
    jump, known = (one[:, devices] for one in jumps)
    return any_size(pull[within] + jump, information[within] + known)


def _from(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, begin: Begin, cost: float
) -> Iterator[Candidate]:
    """The devices that begin at a row: those that were scanned, and the best set of all."""
    signals, values = scorer.space.signals, begin.values
    late = float(np.log(scorer.space.transform.rows))
    begun = Course(law, (), values, np.ones(len(law.names)), begin.row)
    spectra = [scorer.space.transform.quick_spectrum(one) for one in begun.of(signals, values)]
    pull, information = scorer.score(law.patterns, spectra)
    information = scorer.marginal(kind, law.patterns, spectra, information)
    for worth, free in worths_of(kind):
        # One that has no size is sought of any: healthy errors stand in for a part of it.
        size = worth if scales(kind) else any_size
        sets = [best_set(pull, information, law.groups, size, alone=not kind.collective)]
        _, several = sets[0]
        if len(begin.places) == 1 and len(several) != 1:
            # Errors of its neighbours hide that a single one is enough.
            sets.append((begin.evidence + late, begin.places))
        for gain, places in sets:
            names = tuple(law.names[place] for place in places)
            its = kind, law, scorer, replace(begin, places=places), cost, free
            one = Candidate(kind, places, names, values, gain - cost - late, onset=begin.row)
            yield replace(one, finer=partial(exactly, *its))
            yield replace(one, onset=0, finer=partial(always, *its))


def _hopeful_sets(
    law: DeviceLaw, scorer: Scorer, pull: Vector, spectra: Sequence[Single], every: bool
) -> list[Indices]:
    """Groups of devices, and all of them, that may begin late together.

    Args:
        law: Of the devices.
        scorer: Of what is left to explain.
        pull: Of every device over the whole record, shape (D,).
        spectra: Of its courses.
        every: Whether to take all, whatever they show over the whole record.
    """
    count = len(law.names)
    groups = [] if law.standing else [one for one in law.groups.values() if 1 < len(one) < count]
    if not groups:
        return []
    seen = [
        scorer.together(block, spectrum, groups)
        for block, spectrum in zip(law.patterns, spectra, strict=True)
    ]
    information = np.array([[*parts, one] for one, parts in seen]).sum(axis=0)
    sets = [*groups, np.arange(count)]
    total = np.array([pull[one].sum() for one in sets])
    shown = sign(total, information)
    return [np.sort(one) for one, its in zip(sets, shown, strict=True) if every or its > ONSET_SIGN]
