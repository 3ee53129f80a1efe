"""The text of a plan: a movement of the correctors, a longer record, or advice."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.proposals import Limits, Proposal
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.diagnose.result.headline import quantity
from orbitfb.diagnose.result.parts import Experiment
from orbitfb.estimation.priors import SURE
from orbitfb.records.layout import Layout

ENOUGH = 30.0
"""Expected evidence that is enough [nats]. Its standard deviation is √(2 · 30), so 99 of 100 runs
end above 12 nats. The choice of values and places may cost 7 of them."""


@dataclass(frozen=True, slots=True)
class Option:
    """A proposal and its expected result.

    Args:
        proposal: The excitation.
        rate: Expected evidence [nats/tick].
        minutes: Time until the evidence is enough [min].
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
    """Describe a movement of the correctors.

    Args:
        layout: Layout of the record.
        suspects: The effect to be seen, or the first effect and those to be told from it.
        best: The movement.
        limits: Limits that the movement keeps.
        seed: Seed of random levels.
    """
    minutes = min(best.minutes, limits.minutes)
    ticks = int(np.ceil(minutes * 60 / layout.period))
    separated = best.rate * ticks
    part = best.proposal.part
    settings = best.proposal.settings(ticks, layout.period, seed)
    short = "" if separated >= ENOUGH else " That may not be enough: then repeat it."
    experiment = Experiment(
        kind=best.proposal.kind,
        text=f"To {_purpose(suspects)}: {best.proposal.label}, for {minutes:.2g} min. A corrector "
        f"moves by up to {best.amplitude:.3g} A, the orbit by up to {best.orbit * 1e6:.3g} µm rms. "
        f"The expected evidence is {separated:.3g} nats; {SURE:g} nats decide.{short}",
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
    """Describe a longer record: ordinary operation is as good as any movement.

    Args:
        layout: Layout of the record.
        suspects: The effect to be seen, or the first effect and those to be told from it.
        rate: Expected evidence in ordinary operation [nats/tick].
    """
    minutes = ENOUGH / rate * layout.period / 60
    experiment = Experiment(
        kind="longer-record",
        text=f"To {_purpose(suspects)}: record {minutes:.2g} min more of the same operation. No "
        "movement of the correctors within the limits is much faster.",
        splits=tuple(one.kind.id for one in suspects),
        orbit_cost_um=0.0,
        minutes=minutes,
        separation_nats=ENOUGH,
    )
    return Plan(experiment, None, layout)


def advice(layout: Layout, suspects: Sequence[Suspect]) -> Plan:
    """Describe another test, where no movement of the correctors helps.

    Args:
        layout: Layout of the record.
        suspects: The effect to be seen, or the first effect and those to be told from it.
    """
    ways = dict.fromkeys(_other_test(suspects[0], one) for one in suspects[1:] or suspects)
    experiment = Experiment(
        kind="read-only-test",
        text=f"No movement of the correctors within the limits helps to {_purpose(suspects)}. "
        f"Another test: {' '.join(ways)}",
        splits=tuple(one.kind.id for one in suspects),
        separation_nats=0.0,
    )
    return Plan(experiment, None, layout)


def beside(its: Plan, first: Suspect, left: Sequence[Suspect]) -> Plan:
    """Add tests for the rivals that the experiment does not tell apart.

    Args:
        its: The plan for the others.
        first: The effect to be told from all others.
        left: Rivals that no movement of the correctors tells from the first effect.
    """
    if not left:
        return its
    rivals = " or ".join(dict.fromkeys(one.kind.id for one in left))
    ways = " ".join(dict.fromkeys(_other_test(first, one) for one in left))
    text = f"{its.experiment.text} It does not tell {first.kind.id} from {rivals}. For that: {ways}"
    return Plan(its.experiment.model_copy(update={"text": text}), its.settings, its.layout)


def _other_test(first: Suspect, second: Suspect) -> str:
    """Give the test that the effects themselves name, as a sentence."""
    own = first.kind.splits if second.kind.id in first.kind.confused_with else ""
    splits = own or second.kind.splits or first.kind.splits
    return f"{splits.rstrip('.')}." if splits else "None is known."


def _purpose(suspects: Sequence[Suspect]) -> str:
    """Name the purpose of the experiment, to follow "To"."""
    if len(suspects) == 1:
        kind, values = suspects[0].kind, suspects[0].values
        own = (p for p in kind.parameters if p.name == (kind.linear or p.name))
        moved = next((p for p in own if values.get(p.name, p.nominal) != p.nominal), None)
        size = f" of {quantity(values[moved.name], moved.unit)}" if moved else ""
        return f"see {kind.id}{size} better"
    *others, last = [one.kind.id for one in suspects[1:]]
    return f"tell {suspects[0].kind.id} from {', '.join(others) + ' and ' if others else ''}{last}"
