"""The experiments that ambiguous answers ask for: planned as an operator would, done, diagnosed."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from orbitfb.cli.blind_processes import (
    answered,
    command,
    diagnose_all,
    each,
    module,
    rings_of,
    tasks,
)


@dataclass(frozen=True)
class Asked:
    """An experiment that an answer asks for.

    Args:
        case: Name of the record.
        kind: Of experiment.
        splits: Effects to be told apart; or one, to be seen better.
        moves: Whether it moves correctors; all other is no excitation.
    """

    case: str
    kind: str
    splits: tuple[str, ...]
    moves: bool


def asked(answers: Path) -> Iterator[Asked]:
    """List what ambiguous answers ask for.

    Args:
        answers: A directory with `diagnosis.json` for each record.
    """
    for file in sorted(answers.glob("*/diagnosis.json")):
        answer: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if answer.get("state") != "ambiguous":
            continue
        told = answer.get("experiment") or {}
        yield Asked(
            case=file.parent.name,
            kind=told.get("kind") or "none",
            splits=tuple(told.get("splits") or ()),
            moves=told.get("amplitude") is not None and bool(told.get("splits")),
        )


def do_experiments(
    source: Path, data: Path, truth: Path, answers: Path, out: Path, jobs: int
) -> None:
    """Plan, do and diagnose; what is done already is not done again.

    Args:
        source: Checkout with the generator.
        data: Records of the suite.
        truth: Of the suite; only the generator opens it.
        answers: To the suite.
        out: Directory for `plans`, `data`, `truth` and `answers` of the experiments.
        jobs: At the same time.
    """
    plans = out / "plans"
    plans.mkdir(parents=True, exist_ok=True)
    todo = [one for one in asked(answers) if not answered(plans / f"{one.case}.json")]
    each(partial(plan, data, plans), todo, jobs, "experiments planned")
    own = ("--plans", str(plans), "--out", str(out / "data"), "--sealed", str(out / "truth"))
    module(
        source,
        "tests.blind.experiment",
        *("--truth", str(truth), *own, "--jobs", str(jobs)),
        quiet=True,
    )
    diagnose_all(list(tasks(out / "data", out / "answers")), jobs, "experiments diagnosed")


def plan(data: Path, plans: Path, one: Asked) -> None:
    """Get the excitation (CASE.npz) of an experiment, and keep what came of it (CASE.json)."""
    told = plans / f"{one.case}.json"
    asked_for = {"kind": one.kind, "splits": one.splits}
    if not one.moves:
        told.write_text(json.dumps({"exit": 0, **asked_for, "moves": False}), encoding="utf-8")
        return
    record, file = data / "records" / f"{one.case}.npz", plans / f"{one.case}.npz"
    arguments = ["diagnose", "plan", str(record), "--for", one.splits[0], "--out", str(file)]
    if len(one.splits) > 1:
        arguments += ["--against", one.splits[1]]
    ended = command(*arguments, "--json", *rings_of(record, data))
    planned: dict[str, Any] = json.loads(ended.stdout) if ended.code == 0 else {}
    asked_for["kind"] = planned.get("kind", one.kind)
    asked_for["minutes"] = planned.get("minutes")
    asked_for["separation_nats"] = planned.get("separation_nats")
    ended.keep(told, **asked_for, moves=bool(planned.get("file")) or ended.code != 0)
