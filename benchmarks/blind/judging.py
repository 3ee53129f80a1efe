"""One answer against its truth, by one rule for the records of every generator."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.blind.truth import Truth
from orbitfb.physics.places import Kind, Ring

NAMES = ("named", "ambiguous", "named_plus_remainder")
"""States that give a name."""
RECOGNISED = ("unknown", "named_plus_remainder")
"""States that say: here is something that is in no library."""
SURE = 0.9
"""Probability from which a wrong name counts as confidently wrong."""
CLASS = 3
"""Members of a declared class that count. A class of ten names would always be right."""
CLUSTERED = ("optics", "disturbance")
"""Stages whose places stand so close in phase that a neighbour is as good."""


class Order:
    """Where devices stand along a ring, and what else they are called."""

    def __init__(self, ring: Ring) -> None:
        table = ring.table
        self.s = dict(zip(table.name, table.s, strict=True))
        self.kind = dict(zip(table.name, table.kind, strict=True))
        self.quads = table.s[ring.places("QUAD")]
        self.sextupoles = table.s[ring.places("SEXT")]
        kinds: tuple[Kind, ...] = ("BPM", "COR")
        self.called = {
            pv: name for kind in kinds for pv, (name, _) in ring.devices_of_pvs(kind).items()
        }

    def device(self, name: str) -> str:
        """Give a device its name in the table, whichever of its PVs it is called by."""
        return self.called.get(name, name)

    def near(self, first: str, second: str) -> bool:
        """Tell whether at most one element of the same sort lies from one place to the other."""
        if first == second:
            return True
        if first not in self.s or second not in self.s:
            return False
        sextupole = self.kind[first] == "SEXT"
        line = self.sextupoles if sextupole else self.quads
        one, other = (int(np.searchsorted(line, self.s[name] - 1e-9)) for name in (first, second))
        apart = abs(one - other)
        return min(apart, len(line) - apart) <= 1


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of a record.

    Args:
        source: Which generator made it.
        case: Its name.
        truth: What it holds.
        state: Of the answer; `not intact` where the screen refused it, `crash` without an answer.
        names: Named effects, the most probable first.
        probability: Of the first one's class; NaN without a name.
        right: Single: a right id first or among the first three of its class. Pair: every effect
            is named. Foreign: recognised, or its next of kin. None: `no_gap`.
        exact: Whether the first id itself is right.
        top3: Whether a right id is among the best three of causes or tournament.
        one: Pair: whether at least one effect is named.
        misnamed: Named without reserve, with 0.9 or more, and wrong.
        on_right: Probability that the answer puts on a right class; single effects only.
        devices: Intersection over union of named and true devices, by their names in the table
            of places and whichever their plane; NaN where not compared.
        covered: Whether the first comparable parameter lies in its interval; None: not comparable.
        shrink: Told share of the one-step gap that is gone [1].
        recovered: Share of the gain in nats that knowing the truth has on the later record.
        best: Evidence of the best effect of the tournament, named or not [nats].
        seconds: Wall clock [s].
        cpu: Processor time [s].
        peak_mb: Largest memory of the process so far [MB].
        problem: Last words of an engine that gave no answer.
    """

    source: str
    case: str
    truth: Truth
    state: str
    names: tuple[str, ...] = ()
    probability: float = math.nan
    right: bool = False
    exact: bool = False
    top3: bool = False
    one: bool = False
    misnamed: bool = False
    on_right: float = math.nan
    devices: float = math.nan
    covered: bool | None = None
    shrink: float = math.nan
    recovered: float = math.nan
    best: float = math.nan
    seconds: float = math.nan
    cpu: float = math.nan
    peak_mb: float = math.nan
    problem: str = ""

    @property
    def named(self) -> bool:
        """Whether a name was given."""
        return self.state in NAMES

    @property
    def key(self) -> str:
        """What makes it the same record in another run."""
        return f"{self.source}/{self.case}"


def judge(
    truth: Truth,
    answer: Mapping[str, Any] | None,
    *,
    source: str = "",
    case: str = "",
    order: Order | None = None,
    seconds: float = math.nan,
    cpu: float = math.nan,
    peak_mb: float = math.nan,
    problem: str = "",
) -> Judged:
    """Judge an answer.

    Args:
        truth: Of the record.
        answer: In the form of `diagnosis.json`; None: there is none.
        source: Which generator made the record.
        case: Name of the record.
        order: Of the ring; without it a neighbour of a true place counts as another place, and a
            PV as another device.
        seconds: Wall clock that it took [s].
        cpu: Processor time that it took [s].
        peak_mb: Largest memory of its process [MB].
        problem: Last words of an engine without an answer.
    """
    state = "crash" if answer is None else answer.get("state") or "not intact"
    answer = answer or {}
    causes = [cause for cause in answer.get("causes") or () if cause.get("effect")]
    causes.sort(key=lambda cause: -number(cause.get("probability"), 0.0))
    if state not in NAMES:
        causes = []
    held = [{one for c in causes for one in _class(c)} & e.accepted for e in truth.effects]
    right = _right(truth, state, causes, [bool(one) for one in held])
    first = causes[0] if causes else {}
    accepted = frozenset[str]().union(*(effect.accepted for effect in truth.effects))
    kin = bool(causes) and bool(accepted & set(_class(first)))
    probability = number(first.get("probability"))
    top = [cause["effect"] for cause in causes[:CLASS]] + _best(answer)
    covered, devices = None, math.nan
    if truth.kind == "single" and right:
        covered = _covered(first, truth)
        devices = _overlap(first.get("places") or (), truth, order)
    return Judged(
        source,
        case,
        truth,
        state,
        names=tuple(cause["effect"] for cause in causes),
        probability=probability,
        right=right,
        exact=bool(causes) and first["effect"] in accepted,
        top3=right or bool(accepted & set(top)),
        one=any(held),
        misnamed=state == "named" and not probability < SURE and not kin,
        on_right=_on_right(accepted, causes, answer) if truth.kind == "single" else math.nan,
        devices=devices,
        covered=covered,
        shrink=number((answer.get("shrink") or {}).get("um")),
        recovered=_recovered(answer.get("shrink") or {}, truth.oracle_nats),
        best=max((number(row.get("nats")) for row in _rows(answer)), default=math.nan),
        seconds=seconds,
        cpu=cpu,
        peak_mb=peak_mb,
        problem=problem,
    )


def _right(
    truth: Truth, state: str, causes: Sequence[Mapping[str, Any]], held: Sequence[bool]
) -> bool:
    if state in truth.states:
        return True
    if truth.kind == "none":
        return state == "no_gap"
    if truth.kind == "pair":
        return all(held)
    kin = bool(causes) and bool(truth.effects[0].accepted & set(_class(causes[0])))
    return kin or (truth.kind == "foreign" and state in RECOGNISED)


def _class(cause: Mapping[str, Any]) -> list[str]:
    return [cause["effect"], *(cause.get("alternatives") or ())][:CLASS]


def _rows(answer: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return (answer.get("tournament") or {}).get("rows") or []


def _best(answer: Mapping[str, Any]) -> list[str]:
    """Give the best three effects of the tournament."""
    rows = sorted(_rows(answer), key=lambda row: -number(row.get("nats"), -math.inf))
    return list(dict.fromkeys(row.get("effect", "") for row in rows))[:CLASS]


def _on_right(
    accepted: frozenset[str], causes: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]
) -> float:
    """Give the largest probability that is told of a class with a right id; 0: none is."""
    told = [(_class(cause), cause.get("probability")) for cause in causes]
    told += [
        ([row.get("effect"), *(row.get("members") or ())], row.get("probability"))
        for row in _rows(answer)
    ]
    return max((number(p, 0.0) for ids, p in told if accepted & set(ids[:CLASS])), default=0.0)


def _covered(cause: Mapping[str, Any], truth: Truth) -> bool | None:
    """Tell whether the first parameter that both tell lies in its interval."""
    given = cause.get("parameters") or {}
    for name, value in truth.effects[0].parameters.items():
        told = given.get(name) or {}
        low, high = number(told.get("low")), number(told.get("high"))
        if (
            math.isfinite(low)
            and math.isfinite(high)
            and cause["effect"] in truth.effects[0].accepted
        ):
            return low <= value <= high
    return None


def _devices(names: Iterable[str], order: Order | None) -> frozenset[str]:
    """Give the devices behind names with a plane, as in `CH1A_C30 (x)`, and behind PVs."""
    bare = {name.removesuffix(" (x)").removesuffix(" (y)") for name in names}
    return frozenset(bare if order is None else map(order.device, bare))


def _overlap(names: Sequence[str], truth: Truth, order: Order | None) -> float:
    """Give named and true devices over named or true ones; a neighbour counts where it may."""
    effect = truth.effects[0]
    if not effect.places:
        return math.nan
    named, true = _devices(names, order), _devices(effect.places, order)
    near = order is not None and effect.stage in CLUSTERED

    def met(name: str, among: frozenset[str]) -> bool:
        if name in among:
            return True
        return near and order is not None and any(order.near(name, other) for other in among)

    hits = sum(met(name, true) for name in named)
    missed = sum(not met(name, named) for name in true)
    return hits / max(len(named) + missed, 1)


def _recovered(shrink: Mapping[str, Any], oracle: float | None) -> float:
    """Share of what knowing the effect gains on the later record; NaN where either is not told."""
    ticks = shrink.get("held_out_ticks")
    if not oracle or not ticks or shrink.get("on") != "the later record":
        return math.nan
    before, after = (number(shrink.get(f"{key}_nats_per_tick")) for key in ("before", "after"))
    return (before - after) * ticks / oracle


def number(value: Any, missing: float = math.nan) -> float:
    """Read a number that may be missing."""
    return float(value) if isinstance(value, (int, float)) else missing
