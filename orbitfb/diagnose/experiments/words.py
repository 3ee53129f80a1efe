"""What a plan tells people: a movement of the correctors, a longer record, or advice."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.proposals import Limits, Proposal
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.diagnose.result.headline import quantity
from orbitfb.diagnose.result.parts import Experiment
from orbitfb.records.layout import Layout

ENOUGH = 30.0
"""Expected separation [nats]: its scatter is √(2 · 30), so 99 runs in 100 end above 12 nats, of
which 7 may be lost to the choice of values and places."""


@dataclass(frozen=True, slots=True)
class Option:
    """A proposal with what it is worth.

    Args:
        proposal: What is done.
        rate: Expected separation [nats/tick].
        minutes: Until it is enough [min].
        orbit: Largest rms orbit of a tick [m].
        amplitude: Largest excursion of a corrector [A].
    """

    proposal: Proposal
    rate: float
    minutes: float
    orbit: float
    amplitude: float


def movement(
    layout: Layout, suspects: Sequence[Suspect], best: Option, limits: Limits, seed: int
) -> Plan:
    """Tell which movement of the correctors to do.

    Args:
        layout: Of the record.
        suspects: What is to be seen, or to be told from all that follow.
        best: What is done.
        limits: Kept by it.
        seed: Of random levels.
    """
    minutes = min(best.minutes, limits.minutes)
    ticks = int(np.ceil(minutes * 60 / layout.period))
    separated = best.rate * ticks
    part = best.proposal.part
    settings = best.proposal.settings(ticks, layout.period, seed)
    short = "" if separated >= ENOUGH else " That is not enough for certainty; do it again."
    experiment = Experiment(
        kind=best.proposal.kind,
        text=f"To {_purpose(suspects)}: {best.proposal.kind.replace('-', ' ')} "
        f"({best.proposal.label}), up to {best.amplitude:.3g} A and {best.orbit * 1e6:.3g} µm rms, "
        f"for {minutes:.2g} min; {separated:.3g} nats are expected to separate them.{short}",
        splits=tuple(one.kind.id for one in suspects),
        devices=tuple(dict.fromkeys(part.correctors)),
        modes=tuple(mode - 1 for mode in part.modes),
        amplitude=best.amplitude,
        orbit_cost_um=best.orbit * 1e6,
        minutes=minutes,
        separation_nats=separated,
        limits=f"orbit {limits.source}; at most {limits.write.change_per_tick:g} A per tick, "
        f"|setpoint| {limits.write.setpoint:g} A, {limits.minutes:g} min",
    )
    return Plan(experiment, settings, layout)


def longer(layout: Layout, suspects: Sequence[Suspect], rate: float) -> Plan:
    """Say that the record's own activity is as good as anything that could be done.

    Args:
        layout: Of the record.
        suspects: What is to be seen, or to be told from all that follow.
        rate: Expected separation by the record's own activity [nats/tick].
    """
    minutes = ENOUGH / rate * layout.period / 60
    experiment = Experiment(
        kind="longer-record",
        text=f"To {_purpose(suspects)}: {minutes:.2g} min more of the same operation; no movement "
        "of the correctors within the limits is much faster.",
        splits=tuple(one.kind.id for one in suspects),
        orbit_cost_um=0.0,
        minutes=minutes,
        separation_nats=ENOUGH,
    )
    return Plan(experiment, None, layout)


def advice(layout: Layout, suspects: Sequence[Suspect]) -> Plan:
    """Say what the effects themselves say, when no movement of the correctors helps.

    Args:
        layout: Of the record.
        suspects: What is to be seen, or to be told from all that follow.
    """
    ways = dict.fromkeys(_otherwise(suspects[0], one) for one in suspects[1:] or suspects)
    experiment = Experiment(
        kind="read-only-test",
        text=f"No movement of the correctors within the limits helps to {_purpose(suspects)}. "
        f"Beyond the limits, or without the correctors: {'; '.join(ways)}.",
        splits=tuple(one.kind.id for one in suspects),
        separation_nats=0.0,
    )
    return Plan(experiment, None, layout)


def beside(its: Plan, first: Suspect, left: Sequence[Suspect]) -> Plan:
    """Add what would split those that the experiment does not.

    Args:
        its: The plan for the others.
        first: What is to be told from all.
        left: Rivals that no movement of the correctors splits from it.
    """
    if not left:
        return its
    ways = [f"{one.kind.id}: {_otherwise(first, one)}" for one in left]
    text = f"{its.experiment.text} It does not split {first.kind.id} from {'; '.join(ways)}."
    return Plan(its.experiment.model_copy(update={"text": text}), its.settings, its.layout)


def _otherwise(first: Suspect, second: Suspect) -> str:
    """Give what splits two suspects without a movement of the correctors, by their own words."""
    own = first.kind.splits if second.kind.id in first.kind.confused_with else ""
    splits = (own or second.kind.splits or first.kind.splits).rstrip(".")
    return f"{splits[0].lower()}{splits[1:]}" if splits else "nothing known does"


def _purpose(suspects: Sequence[Suspect]) -> str:
    """Say what the experiment is for, after "to"."""
    if len(suspects) == 1:
        kind, values = suspects[0].kind, suspects[0].values
        own = (p for p in kind.parameters if p.name == (kind.linear or p.name))
        moved = next((p for p in own if values.get(p.name, p.nominal) != p.nominal), None)
        size = f" of {quantity(values[moved.name], moved.unit)}" if moved else ""
        return f"see {kind.id}{size} better"
    *others, last = [one.kind.id for one in suspects[1:]]
    return f"tell {suspects[0].kind.id} from {', '.join(others) + ' and ' if others else ''}{last}"
