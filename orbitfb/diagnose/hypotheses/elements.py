"""Rows and columns of the response whose elements are all wrong, each by an amount of its own.

All devices are ranked, the first few are told exactly.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.element_sums import Courses, Free, Told, of_ground
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import HEALTHY_CHANGE, EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, ElementsLaw, Signals
from orbitfb.estimation.priors import FINALISTS, MORE, VALUE_COST
from orbitfb.estimation.transform import Matrix


def scan_elements(kind: EffectKind, law: ElementsLaw, scorer: Scorer) -> list[Candidate]:
    """Find the device whose elements are furthest off, and all that are."""
    space = scorer.space
    courses = Courses.of(law, space)
    free = Free.of(courses, space.noise, scorer.pulled)
    ranked = free.ranked()
    first = [place for place in np.argsort(-ranked)[:FINALISTS] if ranked[place] > 0.0]
    if not first:
        return []
    apart = Free.of(courses, *of_ground(space))
    response = space.signals.record.layout.response
    model = response if law.rows else response.T
    choice = float(np.log(len(law.names))) + VALUE_COST
    found = []
    for one in (free.told(int(place), beside=True) for place in first):
        # Beside a factor of all, which is a gain, and more than those of a healthy ring are.
        odd = free.told(one.place, beside=True, but=model[one.place])
        if odd.evidence > choice and odd.share(law) > HEALTHY_CHANGE:
            found.append(replace(apart.told(one.place), evidence=one.evidence))
    found.sort(key=lambda one: -one.evidence)
    if not found or found[0].evidence < choice:
        return []
    others = [one for one in found[1:] if one.evidence > choice + MORE]
    sets = [found[:1], [found[0], *others]] if others else [found[:1]]
    return [_candidate(kind, courses, its, choice) for its in sets]


def _candidate(
    kind: EffectKind,
    courses: Courses,
    told: Sequence[Told],
    choice: float,
) -> Candidate:
    """Devices with their errors as a candidate.

    Args:
        kind: The effect.
        courses: That drive the elements.
        told: Errors of each device.
        choice: Cost of a device and its width [nats].
    """
    told = sorted(told, key=lambda one: one.place)
    law = courses.law
    sources = tuple(_source(kind, law, one) for one in told)
    field = np.zeros((len(courses.spectrum), law.there.shape[0 if law.rows else 1]))
    for one in told:
        if law.rows:
            field[:, one.place] += courses.spectrum @ one.errors
        else:
            field += np.outer(courses.spectrum[:, one.place], one.errors)

    def again(after: Workspace) -> Candidate:
        noise, whole, its = after.noise, after.residual + field, replace(courses, space=after)
        mean = after.priors.mean(after.terms.pull(noise.pull(whole, after.transform)))
        left = whole - after.terms.contribution(mean)
        free = Free.of(its, noise, noise.pull(left, after.transform))
        return _candidate(kind, its, [free.told(one.place, beside=True) for one in told], choice)

    size = kind.parameters[0].name
    largest = max(sources, key=lambda one: one.values[size])
    return Candidate(
        kind,
        tuple(one.place for one in told),
        tuple(law.names[one.place] for one in told),
        largest.values,
        sum(one.evidence for one in told) - choice * len(told),
        field=field,
        sources=sources,
        cost=sum(one.cost for one in told) + choice * len(told),
        again=again,
    )


def _source(kind: EffectKind, law: ElementsLaw, told: Told) -> Course:
    """The course of one device, its errors as large as they were told."""
    size = kind.parameters[0].name
    there = law.there[told.place]
    share = told.share(law)
    unit = told.errors / max(share, 1e-300)

    def course(values: Values, given: Signals) -> tuple[Matrix, ...]:
        if law.rows:
            return (values[size] * (given.currents @ unit)[:, None],)
        return (values[size] * given.currents[:, [told.place]],)

    pattern = np.zeros((len(law.names) if law.rows else len(law.others), 1))
    if law.rows:
        pattern[told.place] = 1.0
    else:
        pattern[:, 0] = unit
    its = DeviceLaw((pattern,), course, (law.names[told.place],), driven=True)
    elements = dict(zip(law.others, told.errors.tolist(), strict=True))
    kept = {name: elements[name] for name, has in zip(law.others, there, strict=True) if has}
    return Course(its, (0,), {size: share}, np.ones(1), elements=kept)
