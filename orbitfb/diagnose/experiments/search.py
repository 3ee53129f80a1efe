"""The recommended experiment: what would split suspects that a record cannot, at the least cost.

Every excitation that the limits allow is simulated on top of the record at hand. What counts is
how fast it drives the best values of either suspect away from the other, per µm of orbit and minute
of beam time. Where no excitation splits them (late readings against late correctors, noise against
noise) the answer is what the effects themselves say would.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.outlook import Struck, base_rows, loop_gains, outlook
from orbitfb.diagnose.experiments.proposals import (
    ORBIT_LIMIT,
    Limits,
    Proposal,
    orbit_rms,
    proposals,
)
from orbitfb.diagnose.experiments.separation import separation
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.diagnose.experiments.words import ENOUGH, Option, advice, beside, longer, movement
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.result.parts import Experiment
from orbitfb.records.layout import Layout
from orbitfb.safety.limits import LimitSettings

DEFAULT_MINUTES = 10.0
"""Beam time that an experiment may take when nobody says [min]."""

MOST_RIVALS = 4
"""Rivals at most from which an experiment has to split the best suspect."""

_LEAST_TICKS = 200
"""Ticks that an experiment takes at least: fewer tell no floor of their own."""

_GAINED = 1.5
"""By this factor an excitation must be better than the record's own activity."""

_LEAST = 3.0
"""Separation within the beam time below which no excitation is worth it [nats]."""

_SEEN = 2.0
"""That a suspect is there takes half of what tells it from another one."""

_FINALISTS = 4
"""Excitations that are weighed with all healthy errors of the ring, at several amplitudes."""

_FEWEST_ROWS = 100
"""Rows of an unbroken stretch below which no feedback and no orbit is known to go on from."""

_SHARES = (1.0, 1 / 3, 0.1)
"""Amplitudes that are tried, of what the limits allow."""


def limits_of(
    orbit_limit: float | None = None,
    minutes: float = DEFAULT_MINUTES,
    write: LimitSettings | None = None,
) -> Limits:
    """Put limits together.

    Args:
        orbit_limit: Rms orbit in both planes [m]; None: a tenth of the beam size.
        minutes: Beam time at most [min].
        write: Limits of a write; the defaults of the loop when None.
    """
    if orbit_limit is None:
        orbit, source = dict(ORBIT_LIMIT), "a tenth of a beam of 100 µm by 10 µm"
    else:
        orbit, source = {"x": orbit_limit, "y": orbit_limit}, f"{orbit_limit * 1e6:.3g} µm rms"
    return Limits(orbit, write or LimitSettings(), minutes, source)


def experiment_for(
    space: Workspace, first: Candidate, rivals: Sequence[Candidate] = (), seed: int = 1
) -> Experiment | None:
    """Recommend an experiment to somebody whose record cannot decide.

    Args:
        space: On which the candidates were found.
        first: The best one.
        rivals: Those that the record cannot exclude in its place, the likeliest first; none: the
            experiment is to show the first one better.
        seed: Of random levels.

    Returns:
        None where no stretch of the record is long enough to plan from.
    """
    if base_rows(space.signals.record) < _FEWEST_ROWS:
        return None
    others = [Suspect.of(one) for one in rivals[:MOST_RIVALS]]
    return plan(space, Suspect.of(first), others, seed=seed).experiment


def plan(
    space: Workspace,
    first: Suspect,
    rivals: Sequence[Suspect] = (),
    limits: Limits | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Find the experiment that splits a suspect from all its rivals, or shows it better.

    Rivals that no movement of the correctors splits from it are named with what would.

    Args:
        space: The record under the causes that are accepted; none of these is among them.
        first: With its best values.
        rivals: The same; none: it is told from no effect.
        limits: To be kept; the defaults when None.
        seed: Of random levels.
        progress: Told what is done and which share of all.

    Raises:
        EstimationError: The record is too short to be continued.
    """
    tell = progress or (lambda what, share: None)
    limits = limits or limits_of()
    record = space.signals.record
    layout, rows = record.layout, base_rows(record)
    if rows < _FEWEST_ROWS:
        raise EstimationError(
            f"{record.source}: no stretch has {_FEWEST_ROWS} rows to plan an experiment from; "
            "give a longer record"
        )
    gains = loop_gains(record)
    listed = list(proposals(layout, [first, *rivals], limits))
    rated: list[Vector] = []
    for index, proposal in enumerate(listed):
        tell("planning", index / (len(listed) + _FINALISTS))
        excursion = proposal.waveform(layout, rows, seed)
        rated.append(_rates(space, excursion, gains, first, rivals, whole=False))
    allowed = limits.minutes * 60 / layout.period
    split = np.max(rated, axis=0) * allowed >= _LEAST if rivals else np.zeros(0, dtype=bool)
    left = [rival for rival, able in zip(rivals, split, strict=True) if not able]
    if rivals and not split.any():
        return advice(layout, [first, *rivals])
    told = [rival for rival, able in zip(rivals, split, strict=True) if able]
    suspects = [first, *told]
    worst = [float(rates[split].min() if rivals else rates[0]) for rates in rated]
    order = sorted(range(len(listed)), key=lambda index: worst[index], reverse=True)
    options = [
        _option(space, gains, suspects, limits, listed[index], seed) for index in order[:_FINALISTS]
    ]
    tell("planning", 1.0)
    still = np.zeros((rows, record.setpoints.shape[1]))
    passive = float(_rates(space, still, gains, first, told, whole=True).min())
    if passive * allowed >= ENOUGH and max(o.rate for o in options) < _GAINED * passive:
        return beside(longer(layout, suspects, passive), first, left)
    if max(option.rate for option in options) * allowed < _LEAST:
        return advice(layout, suspects)
    within = [option for option in options if option.minutes <= limits.minutes]
    if within:
        best = min(within, key=lambda option: option.orbit * option.minutes)
    else:
        best = max(options, key=lambda option: option.rate)
    return beside(movement(layout, suspects, best, limits, seed), first, left)


def _rates(
    space: Workspace,
    excursion: Vector,
    gains: Vector,
    first: Suspect,
    rivals: Sequence[Suspect],
    *,
    whole: bool,
) -> Vector:
    """Expected separation per tick from every rival; the least of both directions where whole.

    It is no use to tell suspects apart of which none is seen: from none at all counts too then.
    """
    struck = _struck([first, *rivals], space.signals.record.layout)
    view = outlook(space, excursion, gains, None if whole else struck)
    if not rivals:
        return np.array([separation(view, first, None)]) / len(excursion)
    worth = [separation(view, first, rival) for rival in rivals]
    if whole:
        seen = _SEEN * separation(view, first, None)
        worth = [
            min(w, seen, separation(view, r, first)) for w, r in zip(worth, rivals, strict=True)
        ]
    return np.array(worth) / len(excursion)


def _struck(suspects: Sequence[Suspect], layout: Layout) -> Struck:
    """Devices that are struck, by what they are; empty: all."""
    found: dict[str, tuple[int, ...]] = {}
    for one in suspects:
        known, devices = found.get(one.kind.target), one.kind.devices_at(layout, one.places)
        all_of_them = not devices or (known is not None and not known)
        union = tuple(sorted({*(known or ()), *devices}))
        found[one.kind.target] = () if all_of_them else union
    return found


def _option(
    space: Workspace,
    gains: Vector,
    suspects: Sequence[Suspect],
    limits: Limits,
    proposal: Proposal,
    seed: int,
) -> Option:
    """Judge at full amplitude, and at smaller ones where they are enough."""
    record = space.signals.record
    layout, rows = record.layout, base_rows(record)
    found: list[Option] = []
    for share in _SHARES:
        amplitude = tuple(share * each for each in proposal.part.amplitude)
        scaled = replace(proposal, part=proposal.part.model_copy(update={"amplitude": amplitude}))
        excursion = scaled.waveform(layout, rows, seed)
        rates = _rates(space, excursion, gains, suspects[0], suspects[1:], whole=True)
        rate = float(rates.min())
        ticks = max(_LEAST_TICKS, ENOUGH / max(rate, 1e-12))
        orbit = max(float(orbit_rms(layout, excursion, plane).max()) for plane in layout.planes)
        minutes = ticks * layout.period / 60
        found.append(Option(scaled, rate, minutes, orbit, float(np.abs(excursion).max())))
        if minutes > limits.minutes:
            break  # a smaller amplitude takes longer
    enough = [option for option in found if option.minutes <= limits.minutes]
    return min(enough, key=lambda o: o.orbit * o.minutes) if enough else found[0]
