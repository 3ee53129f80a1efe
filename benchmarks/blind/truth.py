"""What a record truly holds, in one form, whoever made it."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmarks.blind.classes import class_of

Level = Literal["none", "easy", "medium", "hard"]
CLEAR, DETECTABLE = 12.0, 6.0
"""d' from which an effect of the own generator is easy, and medium: 72 and 18 nats for somebody
who knows the effect exactly. To choose among a few thousand places and onsets costs some 10."""
_LEVELS: dict[str, Level] = {"null": "none", "easy": "easy", "medium": "medium", "hard": "hard"}
_NAMES = Path(__file__).with_name("external.toml")


class TruthError(Exception):
    """A truth that cannot be used: which file, what is wrong, what to do."""


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """An effect that is in a record.

    Args:
        effect: What its generator calls it.
        accepted: Ids of the library that are right.
        known: Whether the library is asked to hold it. If not, `unknown` and
            `named_plus_remainder` are right, and so is an accepted id: its next of kin.
        stage: Link of the chain that it changes; empty: not told.
        places: Devices that it sits on; empty: the whole ring, or not to be compared.
        parameters: True values by name of the library's parameter, SI.
    """

    effect: str
    accepted: frozenset[str]
    known: bool = True
    stage: str = ""
    places: frozenset[str] = frozenset()
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Truth:
    """What a record holds.

    Args:
        effects: None for a healthy machine.
        level: How hard it is to see; `none` without an effect.
        shrink: Share of the one-step gap in µm that knowing the effects removes [1]; None where
            it is not told, or where nothing but noise is there to be removed.
        oracle_nats: What knowing them gains on the later record [nats].
        ring: `first`: the packaged ring; anything else: not it.
        states: States that are right beside those that follow from the effects.
    """

    effects: tuple[TrueEffect, ...]
    level: Level
    shrink: float | None = None
    oracle_nats: float | None = None
    ring: str = "first"
    states: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Its effects in words."""
        return " + ".join(one.effect for one in self.effects) or "no gap"

    @property
    def kind(self) -> Literal["none", "single", "foreign", "pair"]:
        """How it is scored; `foreign`: one effect that is in no library."""
        if not self.effects:
            return "none"
        if len(self.effects) > 1:
            return "pair"
        return "single" if all(one.known for one in self.effects) else "foreign"


def read_truth(file: Path, names: Path | None = None) -> Truth:
    """Read the truth of a record.

    Args:
        file: As the own generator writes it, or as an external one does.
        names: Table from an external generator's words to ids of the library.

    Raises:
        TruthError: It is no truth, or has an effect that the table does not translate.
    """
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
        return _own(told) if "spec" in told else _external(told, names or _NAMES)
    except TruthError as error:
        raise TruthError(f"{file}: {error}") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TruthError(
            f"{file}: it is no truth of a record ({type(error).__name__}: {error}); it needs "
            "effects with their names, and difficulty or spec"
        ) from error


def _own(told: dict[str, Any]) -> Truth:
    """Read what `benchmarks.blind.generator` has written."""
    effects = tuple(
        TrueEffect(
            effect=one["effect"],
            accepted=class_of(one["effect"]) if one["known"] else frozenset(),
            known=one["known"],
            stage=one["stage"],
            places=frozenset(one["places"]),
            parameters={name: float(its["value"]) for name, its in one["parameters"].items()},
        )
        for one in told["effects"]
    )
    seen = min((one["d_prime"] for one in told["effects"]), default=0.0)
    level: Level = "easy" if seen >= CLEAR else "medium" if seen >= DETECTABLE else "hard"
    # Whoever knows an effect on the mean removes all of it: the same run without it is left.
    mean = bool(effects) and all(one["law"] == "mean" for one in told["effects"])
    return Truth(
        effects,
        level if effects else "none",
        shrink=1.0 if mean else None,
        oracle_nats=told.get("later_oracle_nats"),
        ring=told["ring"],
    )


def _external(told: dict[str, Any], names: Path) -> Truth:
    """Read what an external generator has written, by a table of its words."""
    table = tomllib.loads(names.read_text(encoding="utf-8"))
    effects = tuple(
        _translated(one, table, names) for one in told["effects"] if one["effect"] != "none"
    )
    measured = told.get("measured") or {}
    return Truth(
        effects,
        _LEVELS[told["difficulty"]] if effects else "none",
        shrink=measured.get("shrink") if effects else None,
    )


def _translated(one: dict[str, Any], table: dict[str, Any], names: Path) -> TrueEffect:
    word = one["effect"]
    known, foreign = table["known"].get(word), table["foreign"].get(word)
    if known is None and foreign is None:
        raise TruthError(f"effect {word!r} is not in {names}; add it there, or give --names")
    places: list[str] = []
    if one.get("localised"):
        places = [*one.get("bpm_names", ()), *one.get("corr_names", ())]
    own = table["parameters"]
    return TrueEffect(
        effect=word,
        accepted=frozenset(known or foreign or ()),
        known=known is not None,
        stage=one.get("stage", ""),
        places=frozenset(places),
        parameters={
            own[name]: float(value)
            for name, value in (one.get("params") or {}).items()
            if name in own and isinstance(value, (int, float))
        },
    )
