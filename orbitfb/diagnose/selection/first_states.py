"""What devices that remember held when the record began.

A play, say, stands anywhere between its two ends until the setpoint has moved by its width, and
when it begins to move depends on where. A law that begins in the middle leaves jumps of all its
devices, and a width that is wrong. So the states are sought device by device, each between −1 and
1, and the value that runs in the grid with them; all states alike are possible before.
"""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import evaluated, highest
from orbitfb.diagnose.hypotheses.ranking import cost_of
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.priors import FINENESS, FIRST_STATES, WIDER


def with_first_states(one: Candidate, space: Workspace) -> Candidate:
    """Let the states of a candidate be told once there is a floor that was estimated with it.

    Args:
        one: A candidate; what does not remember, begins late or has values of every device's own
            stays as it is.
        space: That it was tried on.
    """
    kind = one.kind
    if not kind.remembers or one.onset or len(one.sources) != 1 or one.again is not None:
        return one

    def again(after: Workspace) -> Candidate:
        lower = Scorer.of(over(space, after))
        cost = cost_of(kind, one.values, lower)
        widest = next(p.high for p in kind.fitted(space.signals.record) if p.log)
        found = max(
            (_told(one, value, lower, cost) for value in _values(one, widest)),
            key=lambda its: its.evidence,
        )
        pull, information = lower.evaluate([np.asarray(found.field)])
        told = float(pull[0] - 0.5 * information[0, 0])
        return replace(found, cost=told - found.evidence, again=again)

    return replace(one, again=again)


def _name(one: Candidate) -> str:
    """The value that is sought with the states: the one that has a logarithm."""
    return next(p.name for p in one.kind.parameters if p.log)


def _values(one: Candidate, most: float) -> list[float]:
    """Values at which the states are sought, none beyond the most."""
    now = one.sources[0].values[_name(one)]
    return sorted({min(factor * now, max(most, now)) for factor in WIDER})


def _told(one: Candidate, now: float, scorer: Scorer, cost: float) -> Candidate:
    """A candidate near a value of what has a logarithm, and the states that go with it."""
    name = _name(one)
    source = one.sources[0]
    source = replace(source, values={**source.values, name: now})
    first, chosen = _states(source, scorer)

    def at(value: float) -> Candidate:
        return evaluated(
            one.kind, source.law, scorer, one.places, {**source.values, name: value}, 0, True, cost,
            first=first,
        )  # fmt: skip

    root = float(np.sqrt(WIDER[1] / WIDER[0]))
    best = highest(lambda value: at(value).evidence, (now / root, now * root), FINENESS)
    found = max(at(now), at(best), key=lambda its: its.evidence)
    return replace(found, evidence=found.evidence - chosen)


def _states(source: Course, scorer: Scorer) -> tuple[Vector, float]:
    """The likeliest state of every device, shape (k,), and what choosing them costs [nats]."""
    levels = np.linspace(-1.0, 1.0, FIRST_STATES)
    count = len(source.size)
    signals, transform = scorer.space.signals, scorer.space.transform
    blocks: list[list[np.ndarray]] = [[] for _ in source.law.patterns]
    for level in levels:
        courses = replace(source, first=np.full(count, level)).of(signals, source.values)
        for block, course in zip(blocks, courses, strict=True):
            wide = np.broadcast_to(course, (len(course), count)) * source.size
            block.append(transform.quick_spectrum(wide))
    chosen = list(source.places) if source.places else slice(None)
    patterns = [np.tile(one[:, chosen], (1, len(levels))) for one in source.law.patterns]
    spectrum = np.hstack([np.hstack(block) for block in blocks])
    pull, information = scorer.columns(patterns, spectrum)
    pull, own = pull.reshape(len(levels), count), np.diag(information).reshape(len(levels), count)
    information = information.reshape(len(levels), count, len(levels), count)
    state, devices = np.full(count, len(levels) // 2), np.arange(count)
    total = information[:, :, state, devices].sum(axis=2)
    gain = np.zeros((len(levels), count))
    for _ in range(FIRST_STATES):
        before = state.copy()
        for device in devices:
            mine = information[:, :, state[device], device]
            rest = total - mine
            gain[:, device] = (pull - rest - 0.5 * own)[:, device]
            state[device] = int(np.argmax(gain[:, device]))
            total = rest + information[:, :, state[device], device]
        if np.array_equal(before, state):
            break
    best = gain.max(axis=0)
    cost = -np.log(np.mean(np.exp(gain - best), axis=0))
    return levels[state], float(cost.sum())
