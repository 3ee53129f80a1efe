"""One answer against its truth."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.physics.places import Ring
from tests.blind.classes import same_class

NAMES = ("named", "ambiguous", "named_plus_remainder")
"""States that give a name."""

CLUSTERED = ("optics", "disturbance")
"""Stages whose places stand so close in phase that a neighbour is as good."""


@dataclass
class Judged:
    """What became of a case.

    Args:
        case: Its name.
        truth: As written by the generator.
        state: Of the answer; `crash` when there is none.
        effects: Named, the most probable first.
        probability: Of the first one.
        exact: Whether the first is the true effect itself.
        right: Whether it, its declared class or its class by construction holds the true one.
        top3: Whether the true effect is among the three best.
        size: Members of the first one's class.
        place: Whether the devices are right; None where the effect has none or is not right.
        covered: Whether the first comparable parameter lies in its interval; None: not comparable.
        recovered: Share of the oracle's gain on the later record.
        fitted: Share of the oracle's gain on the whole of the record itself; the answer's is
            held out too, block by block, of the rows that it was fitted to.
        shrink_um: Share of the gap that is gone on the later record.
        stage: Stage that the answer gives, also of what is unknown.
        pair: Whether the set of effects is exactly the true one (both ends of a straight are one).
        seconds: That it took; NaN when not told.
    """

    case: str
    truth: dict[str, Any]
    state: str
    effects: list[str] = field(default_factory=list)
    probability: float = float("nan")
    exact: bool = False
    right: bool = False
    top3: bool = False
    size: int = 0
    place: bool | None = None
    covered: bool | None = None
    recovered: float = float("nan")
    fitted: float = float("nan")
    shrink_um: float = float("nan")
    stage: str = ""
    pair: bool = False
    seconds: float = float("nan")

    @property
    def kind(self) -> str:
        """Its true effects in words."""
        return " + ".join(e["effect"] for e in self.truth["effects"]) or "no gap"

    @property
    def named(self) -> bool:
        return self.state in NAMES

    @property
    def single(self) -> bool:
        return len(self.truth["effects"]) == 1

    @property
    def known(self) -> bool:
        return all(e["known"] for e in self.truth["effects"])

    @property
    def d_prime(self) -> float:
        return min((e["d_prime"] for e in self.truth["effects"]), default=0.0)

    @property
    def dithered(self) -> bool:
        return self.truth["dither"] != "passive"


class Order:
    """Where devices stand along a ring, for answers that are off by one."""

    def __init__(self, ring: Ring) -> None:
        table = ring.table
        self.s = dict(zip(table.name, table.s, strict=True))
        self.kind = dict(zip(table.name, table.kind, strict=True))
        self.quads = table.s[ring.places("QUAD")]
        self.sextupoles = table.s[ring.places("SEXT")]

    def near(self, first: str, second: str) -> bool:
        """Whether at most one element of the same sort lies from one place to the other."""
        if first == second:
            return True
        if first not in self.s or second not in self.s:
            return False
        sextupole = self.kind[first] == "SEXT"
        line = self.sextupoles if sextupole else self.quads
        one, other = (int(np.searchsorted(line, self.s[name] - 1e-9)) for name in (first, second))
        apart = abs(one - other)
        return min(apart, len(line) - apart) <= 1


def judge(truth: dict[str, Any], folder: Path, orders: dict[str, Order]) -> Judged:
    """Judge the answer that lies in a folder.

    Args:
        truth: As written by the generator.
        folder: With `diagnosis.json`, and `run.json` of the process that wrote it.
        orders: By ring.
    """
    found = Judged(truth["case"], truth, "crash")
    try:
        answer = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        causes = [c for c in answer.get("causes") or [] if c.get("effect")]
    except (OSError, ValueError, AttributeError):
        return found
    found.state = answer.get("state") or "integrity"
    found.seconds = _seconds(folder)
    causes.sort(key=lambda c: -(c.get("probability") or 0.0))
    if found.named:
        found.effects = [c["effect"] for c in causes]
    if causes:
        found.stage = causes[0].get("stage") or ""
    stages = (answer.get("unknown") or {}).get("stages") or {}
    if found.state == "unknown" and stages:
        found.stage = max(stages, key=lambda stage: _number(stages[stage], 0.0))
    shrink = answer.get("shrink") or {}
    found.shrink_um = _number(shrink.get("um"))
    if not truth["effects"] or not found.named or not causes:
        found.top3 = _in_top3(truth, causes, answer)
        return found
    found.probability = _number(causes[0].get("probability"))
    found.size = 1 + len(causes[0].get("alternatives") or ())
    _compare(found, causes, truth["effects"], orders[truth["ring"]])
    found.top3 = found.right or _in_top3(truth, causes, answer)
    gains = [_number(c.get("held_out_nats")) for c in causes]
    oracle = sum(e["oracle_nats"] for e in truth["effects"])
    if np.isfinite(gains).all() and oracle:
        found.fitted = float(np.sum(gains) / oracle)
    found.recovered = _recovered(shrink, truth.get("later_oracle_nats"))
    return found


def _recovered(shrink: dict[str, Any], oracle: float | None) -> float:
    """Share of what knowing the effect gains on the later record; NaN where either is not told."""
    ticks = shrink.get("held_out_ticks")
    if not oracle or not ticks or shrink.get("on") != "the later record":
        return float("nan")
    before, after = (_number(shrink.get(f"{key}_nats_per_tick")) for key in ("before", "after"))
    return (before - after) * ticks / oracle


def _compare(
    found: Judged, causes: list[dict[str, Any]], effects: list[dict[str, Any]], order: Order
) -> None:
    first = causes[0]
    true = next((e for e in effects if _holds(first, e["effect"])), None)
    found.right = true is not None
    held = [[_holds(cause, effect["effect"]) for effect in effects] for cause in causes]
    found.pair = all(map(any, held)) and all(map(any, zip(*held, strict=True)))
    if true is None:
        return
    found.exact = first["effect"] == true["effect"]
    if true["places"]:
        near = true["stage"] in CLUSTERED
        found.place = _same_places(first.get("places") or [], true["places"], order, near)
    if found.exact:
        found.covered = _covered(first.get("parameters") or {}, true["parameters"])


def _holds(cause: dict[str, Any], effect: str) -> bool:
    """Whether a cause is an effect, declares it as of its class, or is of its class anyway."""
    declared = (cause["effect"], *(cause.get("alternatives") or ()))
    return effect in declared or same_class(cause["effect"], effect)


def _same_places(named: Sequence[str], true: Sequence[str], order: Order, near: bool) -> bool:
    if set(named) == set(true):
        return True
    if not near or not named:
        return False
    met = all(any(order.near(a, b) for b in true) for a in named)
    return met and all(any(order.near(a, b) for b in named) for a in true)


def _covered(given: dict[str, Any], true: dict[str, Any]) -> bool | None:
    """Whether the first parameter that both tell lies in its interval."""
    for name, its in true.items():
        told = given.get(name)
        if told and told.get("low") is not None and told.get("high") is not None:
            return bool(told["low"] <= its["value"] <= told["high"])
    return None


def _in_top3(truth: dict[str, Any], causes: list[dict[str, Any]], answer: dict[str, Any]) -> bool:
    rows = (answer.get("tournament") or {}).get("rows") or []
    rows = sorted(rows, key=lambda r: -_number(r.get("nats"), -np.inf))
    best = list(dict.fromkeys(r.get("effect", "") for r in rows))[:3]
    best += [c["effect"] for c in causes[:3]]
    return any(same_class(e["effect"], name) for e in truth["effects"] for name in best)


def _number(value: Any, missing: float = float("nan")) -> float:
    return float(value) if isinstance(value, (int, float)) else missing


def _seconds(folder: Path) -> float:
    try:
        told = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        return _number(told.get("seconds"))
    except (OSError, ValueError):
        return float("nan")
