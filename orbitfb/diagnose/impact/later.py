"""The causes on a later record: what is named there, with the values told, and what is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.impact.pieces import Differences, columns_of
from orbitfb.diagnose.likelihood.corrected import hearing
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, FieldLaw, PairLaw
from orbitfb.estimation.priors import HEARD
from orbitfb.estimation.transform import Matrix
from orbitfb.records.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Later:
    """A later record, and what the causes add to it.

    Args:
        explained: Of it; None where nothing that was named can be foretold there.
        untold: Effects whose course there nobody can foretell.
    """

    explained: Explained | None
    untold: tuple[str, ...]

    @classmethod
    def of(
        cls,
        later: Record,
        kinds: Sequence[EffectKind],
        its: Explained,
        causes: Sequence[Named],
    ) -> "Later":
        """Bring causes to a later record; its floor is estimated there, causes in the model.

        Args:
            later: Of the same devices.
            kinds: Effects that were tested.
            its: What they add to the record itself.
            causes: In their order.
        """
        record = its.space.signals.record
        since = later.began - record.began if record.began and later.began else 0.0
        # Where nobody knows how much later, what grows goes on behind the end of the record.
        since = max(since, float(record.time[-1]) + record.layout.period)
        later = replace(later, time=later.time - later.time[0] + since)
        able = [kind for kind in kinds if not kind.unavailable(later)]
        space = Workspace.of(later, able)
        if len(space.blocks) > len(its.space.blocks):
            return cls(None, tuple(one.kind.id for one in causes))
        known = np.zeros(len(space.terms))
        _carry(its.space, space, its.sizes, known)
        usual = known.copy()
        fields: list[Matrix | None] = []
        untold: list[str] = []
        for cause in causes:
            total: Matrix | None = None
            for part in cause.parts:
                field, heard = _field(part, its, space)
                columns = columns_of(part, its.space)
                if len(columns):
                    own = np.zeros_like(known)
                    inside = columns[columns < len(known)]
                    bend = space.bend_of(usual)
                    own[inside], usual[inside] = known[inside], 0.0
                    field = space.terms.contribution(own) + bend - space.bend_of(usual)
                if heard is not None:
                    space = heard
                if field is not None:
                    total = field if total is None else total + field
                elif part.field is not None:
                    untold.append(cause.kind.id)
            fields.append(total)
        if all(one is None for one in fields):
            return cls(None, tuple(dict.fromkeys(untold)))
        found = Explained(
            space, known, space.terms.contribution(usual) + space.bend_of(usual),
            np.zeros_like(space.plain), tuple(fields), its.pieces, its.differences, space.noise,
        )  # fmt: skip
        mended = space.explaining(found.named).with_floor()
        return cls(found.over(mended.noise), tuple(dict.fromkeys(untold)))


def lacking(causes: Sequence[Named], record: Record, later: Record) -> tuple[str, ...]:
    """Channels that causes follow and a later record does not have."""
    needed = (
        name
        for cause in causes
        for part in cause.parts
        for name in cause.kind.follows(part.values, record)
    )
    return tuple(dict.fromkeys(name for name in needed if name not in later.auxiliary))


def _carry(first: Workspace, later: Workspace, sizes: Vector, known: Vector) -> None:
    """Take the errors that the first record has shown for those of the later one."""
    own = {(b.kind.id, b.columns.start): b for b in later.blocks}
    for block in first.blocks:
        its = own.get((block.kind.id, block.columns.start))
        if its is not None and not block.accepted:
            known[its.columns] = sizes[block.columns]


def _field(
    part: Candidate, its: Explained, space: Workspace
) -> tuple[Matrix | None, Workspace | None]:
    """What a candidate adds to a later record; and the record as it is then heard."""
    if part.field is None:
        return None, None
    kind, signals = part.kind, space.signals
    first, laws = its.space.courses.laws(kind), space.courses.laws(kind)
    values = kind.long_after(part.values)
    if part.sources:
        moved = [replace(one, law=_same(one, first, laws), onset=0, kick=False, first=None,
                         values=kind.long_after(one.values)) for one in part.sources]  # fmt: skip
        if any(one.law.periodic for one in moved):
            return None, None
        heard: Workspace | None = None
        own = its.differences.get(id(part), {})
        field = _summed(kind, moved, own, space)
        if kind.target == "bpm":
            for _ in range(HEARD):
                heard = hearing(heard or space, space.transform.summed(field))
                field = _summed(kind, moved, own, heard)
        return field, heard
    for law in laws:
        if isinstance(law, FieldLaw):
            return space.transform.spectrum(law.course(values, signals)), None
        if isinstance(law, PairLaw):
            return _of_pair(part, law, space), None
    return None, None


def _same(one: Course, first: Sequence[object], laws: Sequence[object]) -> DeviceLaw:
    """The law of the same number on another record."""
    number = next((i for i, law in enumerate(first) if law is one.law), None)
    law = one.law if number is None else laws[number]  # one of a device alone acts on any signals
    return law if isinstance(law, DeviceLaw) else one.law


def _summed(
    kind: EffectKind,
    moved: Sequence[Course],
    differences: Mapping[int, Differences],
    space: Workspace,
) -> Matrix:
    """What devices add, their differences to first order, shape (T, n) [m]."""
    total = np.zeros_like(space.plain)
    for number, one in enumerate(moved):
        own = differences.get(number, {})
        for name, patterns, courses in one.columns(kind, space.signals) if own else ():
            if name in own:
                total += space.transform.spectrum(courses * own[name]) @ patterns.T
        total += space.transform.spectrum(one.added(space.signals))
    return total


def _of_pair(part: Candidate, law: PairLaw, space: Workspace) -> Matrix | None:
    for number, struck in enumerate(law.struck):
        if struck == part.places:
            pair = law.pairs[number]
            courses = law.courses[:, pair] @ law.mixing(part.values)[number].T
            return space.transform.spectrum(courses) @ law.patterns[:, pair].T
    return None
