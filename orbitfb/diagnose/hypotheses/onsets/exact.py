"""A law that begins in the middle of a record: its row and its size, exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import choices, evaluated, field_of
from orbitfb.diagnose.hypotheses.jumps import of_jumps
from orbitfb.diagnose.hypotheses.ranking import any_size, within
from orbitfb.diagnose.hypotheses.refit import Course, based
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalTerms, given_size, normal_size
from orbitfb.estimation.maxima import highest
from orbitfb.estimation.priors import FINENESS, ONSETS_EVERY, SIZE_WIDTH, STANDING, UNTOLD
from orbitfb.estimation.transform import Matrix

HOPEFUL = 24
"""Devices whose onsets are looked for at most, those of which most shows."""

_LIKELY = 0.25
"""Share of its given size that a law shows at least, if it is there [1]: below a half it is less
likely than nothing. By hand, for time: a row that is a little wrong may leave half of that."""

_COLUMNS = 400
"""Courses of single devices that are weighed exactly at the first look. By hand, for time: a single
device is looked at in all rows that were scanned, 24 in the best 16 of them."""


@dataclass(frozen=True, slots=True)
class Begin:
    """Devices that begin late.

    Args:
        evidence: As scanned, less the choice of devices and row.
        places: Numbers of the devices: a single one, a group, or all (empty).
        row: At which they begin.
        values: Of the parameters.
        others: Further rows to look at, the best of those that were scanned first: healthy errors
            make a law look much the same from many of them.
        together: What all devices show, each of a size of its own, from the row from which they
            show most [nats].
        about: That row.
        around: Name of a value of theirs that is sought, and the ends between which; None: none is.
    """

    evidence: float
    places: tuple[int, ...]
    row: int
    values: Values
    others: tuple[int, ...] = ()
    together: float = 0.0
    about: int = 0
    around: tuple[str, float, float] | None = None


def exactly(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, begin: Begin, cost: float, free: bool
) -> Candidate:
    """A set that begins late, with and without what its beginning kicks, row by row.

    The row is told by at most `HOPEFUL` of its devices: first among those that were scanned, then,
    if the law may be there at all, around the best of them; and again over a floor that was
    estimated with it.
    """
    places, values = begin.places, begin.values
    row, kick, likely = _best_row(law, scorer, begin, free)
    if begin.around is not None and not free and likely:
        name, *ends = begin.around

        def near(value: float) -> float:
            its = kind, law, scorer, places, {**values, name: value}, row, free, cost, kick
            return evaluated(*its).evidence

        value = highest(near, (ends[0], ends[1]), FINENESS)  # never quite an end
        if near(value) > near(values[name]):
            values = {**values, name: value}
            row, kick, _ = _best_row(law, scorer, replace(begin, values=values, row=row), free)
    known = replace(begin, row=row, values=values, others=(begin.row, *begin.others))

    def again(after: Workspace) -> Candidate:
        return exactly(kind, law, Scorer.of(over(scorer.space, after)), known, cost, free)

    found = evaluated(kind, law, scorer, places, values, row, free, cost, kick)
    if free and 0 < len(places) <= HOPEFUL:
        # What stands in a device before it begins is in no record: it may kick by any of it.
        kicked = kicking(kind, law, scorer, replace(begin, row=row), cost)
        found = max(found, kicked, key=lambda one: one.evidence)
    return replace(found, again=again)


def _best_row(law: DeviceLaw, scorer: Scorer, begin: Begin, free: bool) -> tuple[int, bool, bool]:
    """The row at which devices begin, whether what they have reached comes at once, and if likely.

    Args:
        law: Of them.
        scorer: Of what is left to explain.
        begin: The devices, and rows to look at.
        free: Whether they may have any size.
    """
    devices = (begin.places or tuple(range(len(law.names))))[:HOPEFUL]
    worth, last = any_size if free else given_size, scorer.space.transform.rows - 2
    best = (-np.inf, begin.row, False)
    tried = (begin.row, *begin.others)[: _COLUMNS // len(devices)]
    likely = False
    for _ in range(2):
        shown = False
        for kick in (False, True) if law.first is None else (False,):
            pull, information = _by_row(law, scorer, begin.values, devices, tried, kick)
            gain = worth(pull, information)
            place = int(np.argmax(gain))
            best = max(best, (float(gain[place]), tried[place], kick))
            shown = shown or free or bool(np.any(pull > _LIKELY * information))
        likely = likely or shown
        if not shown:
            break
        near = range(best[1] - 2 * ONSETS_EVERY, best[1] + 2 * ONSETS_EVERY)
        tried = tuple(one for one in near if 0 < one < last)
    return best[1], best[2], likely


def always(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, begin: Begin, cost: float, free: bool
) -> Candidate:
    """The same from the beginning on: no row is chosen.

    Of a law that remembers the first rows tell nothing, as what was before the record is unknown.
    One that is undone in the readings is so in all of them.
    """
    places, values = begin.places, begin.values
    rows = range(UNTOLD + 1) if law.undone is None else range(1)
    devices = places or tuple(range(len(law.names)))
    worth = any_size if free else given_size
    row = int(np.argmax(worth(*_by_row(law, scorer, values, devices, rows, kick=False))))
    found = evaluated(kind, law, scorer, places, values, row, free, cost)
    if row:
        spared = float(np.log(scorer.space.transform.rows))
        whole = None if found.cost is None else found.cost - spared
        found = replace(found, evidence=found.evidence + spared, cost=whole)

    def again(after: Workspace) -> Candidate:
        return always(kind, law, Scorer.of(over(scorer.space, after)), begin, cost, free)

    return replace(found, again=again)


def _by_row(
    law: DeviceLaw,
    scorer: Scorer,
    values: Values,
    devices: Sequence[int],
    rows: Sequence[int],
    kick: bool,
) -> tuple[Vector, Vector]:
    """Pull and information of devices that begin together at a row, exactly, for every row."""
    signals, numbers = scorer.space.signals, devices
    if law.some is not None:
        signals, numbers = law.some(signals, np.array(devices)), range(len(devices))
    reached = None if law.first is None else law.first(values, signals)
    patterns, late = [], []  # courses by row, of every device
    for pattern, course in zip(law.patterns, law.course(values, signals), strict=True):
        for number, device in zip(numbers, devices, strict=True):
            own = course if course.shape[1] == 1 else course[:, [number]]
            known = [None if reached is None else reached[row, [number]] for row in rows]
            base = [based(own, row, kick, one) for row, one in zip(rows, known, strict=True)]
            begun = np.arange(len(own))[:, None] >= np.array(rows)
            patterns.append(pattern[:, device])
            late.append(np.where(begun, own - np.hstack(base), 0.0))
    courses = np.stack(late, axis=2).reshape(len(late[0]), -1)
    spectrum = scorer.space.transform.quick_spectrum(courses)
    return scorer.each(np.stack(patterns, axis=1), spectrum)


def kicking(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    begin: Begin,
    cost: float,
) -> Candidate:
    """Devices that begin late, each kicking by an orbit that stands in it, plane by plane."""
    places, onset, values = begin.places, begin.row, begin.values
    space = scorer.space
    source = Course(law, places, values, np.ones(len(places)), onset)
    courses = source.of(space.signals, values)
    fields = [field_of(law, scorer, courses, source.places, source.size)]
    jump = (np.arange(space.transform.rows) >= onset).astype(float)[:, None]
    spectrum = space.transform.quick_spectrum(jump)
    whole = law.course(values, space.signals)
    for device in places:
        for pattern, course in zip(law.patterns, whole, strict=True):
            own = course if course.shape[1] == 1 else course[:, [device]]
            size = standing(space.transform.quick_spectrum(own))
            fields.append(spectrum @ (size * pattern[:, [device]]).T.astype(np.float32))
    pull, information = scorer.evaluate(fields)
    variance = np.array([SIZE_WIDTH**2, *np.ones(len(fields) - 1)])
    terms = NormalTerms(pull, information, variance)
    sizes = terms.held(within(kind, values, float(terms.mean()[0])))
    size = float(sizes[0])
    added = sum(k * one for k, one in zip(sizes, fields, strict=True))
    gain = terms.evidence_at(sizes) - cost - choices(law, places) - np.log(space.transform.rows)
    worth = float(pull @ sizes - 0.5 * sizes @ information @ sizes)
    scaled = {**values, **{one.name: size * values[one.name] for one in kind.sizes}}
    return Candidate(
        kind, places, tuple(law.names[one] for one in places), scaled, float(gain), onset=onset,
        field=np.asarray(added, dtype=float), sources=(replace(source, size=size * source.size),),
        cost=worth - float(gain),
    )  # fmt: skip


def standing(spectrum: Single) -> Vector:
    """Size that a first kick may have, in the units of a course, (D,) or (1,) of (T, D or 1)."""
    return STANDING * np.sqrt(np.mean(spectrum.astype(np.float64) ** 2, axis=0))


def kicks_of(law: DeviceLaw, scorer: Scorer, spectra: Sequence[Single]) -> Matrix:
    """Log evidence of a first kick of any size of every device at every step, shape (T, D)."""
    total: Matrix | float = 0.0
    for pattern, spectrum in zip(law.patterns, spectra, strict=True):
        pull, own = of_jumps(pattern, scorer)
        variance = standing(spectrum) ** 2
        total = total + normal_size(pull, np.broadcast_to(own, pull.shape), variance)
    return np.asarray(total)
