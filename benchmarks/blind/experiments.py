"""The experiments that ambiguous answers ask for: planned as an operator would, done, diagnosed."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from benchmarks.blind.figures import Figure, rate
from benchmarks.blind.judging import NAMES, RECOGNISED, Judged
from benchmarks.blind.records import Case
from benchmarks.blind.truth import read_truth
from benchmarks.blind.workers import ONE_THREAD

Outcome = Literal["done", "no excitation", "no plan", "not done"]


@dataclass(frozen=True, slots=True)
class Asked:
    """An experiment that an answer asks for.

    Args:
        case: That was answered.
        kind: Of experiment.
        splits: Effects to be told apart; or one, to be seen better.
        moves: Whether it moves correctors; all other is no excitation.
    """

    case: Case
    kind: str
    splits: tuple[str, ...]
    moves: bool


@dataclass(frozen=True, slots=True)
class Tried:
    """What became of an experiment.

    Args:
        asked: What was asked for.
        outcome: `done`; `no excitation`, if it moves no corrector; `no plan`, if planning failed;
            `not done`, if the generator could not.
        judged: The answer to the new record; None where there is none to judge.
    """

    asked: Asked
    outcome: Outcome
    judged: Judged | None = None

    @property
    def resolved(self) -> bool:
        """Whether the new answer is sure and right: the very effect, none of its class."""
        if self.judged is None:
            return False
        kind = self.asked.case.truth.kind
        if kind == "none":
            return self.judged.state == "no_gap"
        if kind == "foreign":
            return self.judged.state in RECOGNISED
        sure = self.judged.state in NAMES and self.judged.state != "ambiguous"
        return sure and _very(self.judged)

    def line(self) -> dict[str, Any]:
        """Tell it as the results have it."""
        its = self.judged
        return {
            "record": f"{self.asked.case.source}/{self.asked.case.name}",
            "true": self.asked.case.truth.title,
            "splits": list(self.asked.splits),
            "kind": self.asked.kind,
            "outcome": self.outcome,
            "state": None if its is None else its.state,
            "names": [] if its is None else list(its.names),
            "resolved": self.resolved,
        }


def _very(judged: Judged) -> bool:
    return judged.names[:1] == (judged.truth.effects[0].effect,)


def asked(case: Case, answer: Mapping[str, Any] | None) -> Asked | None:
    """Tell what an answer asks for; None: it is not ambiguous."""
    if answer is None or answer.get("state") != "ambiguous":
        return None
    told = answer.get("experiment") or {}
    splits = tuple(told.get("splits") or ())
    moves = told.get("amplitude") is not None and bool(splits)
    return Asked(case, told.get("kind") or "none", splits, moves)


def do_experiments(todo: Sequence[Asked], out: Path, jobs: int) -> list[tuple[Asked, Case | None]]:
    """Plan and do experiments of the own generator; what is done already is not done again.

    Args:
        todo: All of one folder of records; its truth is opened by the generator only.
        out: Folder for `plans`, and for the new records and their truth.
        jobs: Processes.

    Returns:
        Every experiment with its new record; None where there is none.
    """
    moving = [one for one in todo if one.moves]
    if not moving:
        return [(one, None) for one in todo]
    plans, records, sealed = out / "plans", out / "records", out / "records_truth"
    plans.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(partial(plan, plans), moving))
    folder = moving[0].case.record.parent
    truth = folder.with_name(f"{folder.name}_truth")
    _run(
        "benchmarks.blind.generator.experiment",
        *("--truth", str(truth), "--plans", str(plans), "--out", str(records)),
        *("--sealed", str(sealed), "--jobs", str(jobs)),
    )
    done: list[tuple[Asked, Case | None]] = []
    for one in todo:
        record = records / f"{one.case.name}.npz"
        new = None
        if one.moves and record.exists():
            new = replace(
                one.case,
                source=f"{one.case.source} experiments",
                record=record,
                truth=read_truth(sealed / f"{one.case.name}.json"),
                later=None,
            )
        done.append((one, new))
    return done


def plan(plans: Path, one: Asked) -> None:
    """Ask for the excitation (CASE.npz) of an experiment."""
    file = plans / f"{one.case.name}.npz"
    if file.exists():
        return
    arguments = [str(one.case.record), "--for", one.splits[0], "--out", str(file), "--json"]
    if len(one.splits) > 1:
        arguments += ["--against", one.splits[1]]
    if one.case.ring is not None:
        arguments += ["--places", str(one.case.ring[0]), "--ring", str(one.case.ring[1])]
    _run("orbitfb", "diagnose", "plan", *arguments)


def _run(module: str, *arguments: str) -> bool:
    """Run a module as a process of its own; tell whether it ended well."""
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        env={**os.environ, **ONE_THREAD},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        print(f"{module}: {done.stderr.strip()[-300:]}", file=sys.stderr)
    return done.returncode == 0


def tried(one: Asked, new: Case | None, plans: Path, judged: Judged | None) -> Tried:
    """Say what became of an experiment."""
    if not one.moves:
        return Tried(one, "no excitation")
    if new is None:
        planned = (plans / f"{one.case.name}.npz").exists()
        return Tried(one, "not done" if planned else "no plan")
    return Tried(one, "done", judged)


def resolving(all_: Sequence[Tried]) -> list[Figure]:
    """Give the figures of experiments. One that could not be planned did not resolve."""
    moved = [one for one in all_ if one.outcome in ("done", "no plan")]
    known = [one for one in moved if one.asked.case.truth.kind in ("single", "pair")]
    others = [one for one in moved if one not in known]
    return [
        rate("experiment resolves an ambiguous answer", (one.resolved for one in known), "≥ 0.80"),
        rate("experiment shows that a name was none", (one.resolved for one in others)),
        rate(
            "ambiguous, and no excitation is recommended",
            (one.outcome == "no excitation" for one in all_),
        ),
    ]
