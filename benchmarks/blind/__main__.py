"""Diagnose fresh records and score the answers: `python -m benchmarks.blind --help`."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from benchmarks.blind import engines, fodo, many, sources
from benchmarks.blind.compare import compare, rows
from benchmarks.blind.experiments import Tried, asked, do_experiments, resolving, tried
from benchmarks.blind.generator.suites import Suite
from benchmarks.blind.judging import Judged, Order, judge
from benchmarks.blind.records import Case, left_out, read_folder, read_list
from benchmarks.blind.table import engine_document, engine_text, figures_text, paired_text
from benchmarks.blind.truth import TruthError
from benchmarks.blind.workers import LONGEST, Answer, Task, diagnose_all
from benchmarks.circumstances import circumstances
from orbitfb.physics.places import Ring

FODO = 50
"""Records of the small ring, five of each kind, unless --first says otherwise."""


def gather(options: argparse.Namespace) -> list[Case]:
    """Make and read the records of every generator that was asked for."""
    cases: list[Case] = []
    out: Path = options.out / "records"
    for seed in options.own or ():
        cases += sources.own(out, options.suite, seed, options.first, options.jobs)
    for seed in options.fodo or ():
        folder = out / f"fodo-{seed}"
        chosen = fodo.generate(seed, folder, options.first or FODO)
        cases += read_folder(folder, source=f"fodo {seed}", chosen=chosen)
    for seed in options.many or ():
        folder = out / f"many-{seed}"
        chosen = many.generate(seed, folder, options.first, options.suite == "healthy")
        cases += read_folder(folder, source=f"many {seed}", chosen=chosen)
    if options.plant is not None:
        try:
            cases += sources.external(
                options.plant, out, options.seed, options.first, options.jobs, options.names
            )
        except sources.SourceError as error:
            print(f"left out: --plant {error}", file=sys.stderr)
    for folder in options.folder or ():
        cases += read_folder(folder, names=options.names)
    for file in options.cases or ():
        cases += read_list(file)
    if options.leave_out:
        cases += left_out(cases)
    return cases


def ask(engine: str, cases: Sequence[Case], options: argparse.Namespace) -> list[Answer]:
    """Ask an engine about records."""
    state = engines.fingerprint(engine)
    folder = options.out / "answers" / engine.replace(":", ".")
    tasks = [
        Task(
            engine,
            case.record,
            None if options.no_later else case.later,
            case.ring,
            case.without,
            folder / case.source.replace(" ", "-") / f"{case.name}.json",
            state,
        )
        for case in cases
    ]
    return diagnose_all(tasks, options.jobs, options.longest)


def judge_all(cases: Sequence[Case], answers: Sequence[Answer]) -> list[Judged]:
    """Judge answers against the truth."""
    orders: dict[tuple[Path, Path] | None, Order] = {}
    judged = []
    for case, answer in zip(cases, answers, strict=True):
        if case.ring not in orders:
            orders[case.ring] = Order(Ring.load(*(case.ring or (None, None))))
        judged.append(
            judge(
                case.truth,
                answer.diagnosis,
                source=case.source,
                case=case.name,
                order=orders[case.ring],
                seconds=answer.seconds,
                cpu=answer.cpu,
                peak_mb=answer.peak_mb,
                problem=answer.problem,
            )
        )
    return judged


def try_experiments(
    engine: str, cases: Sequence[Case], answers: Sequence[Answer], options: argparse.Namespace
) -> list[Tried]:
    """Do what ambiguous answers to records of the own generator recommend, and diagnose it."""
    found: list[Tried] = []
    for source in dict.fromkeys(case.source for case in cases):
        if not source.startswith("own ") or source.endswith("left out"):
            continue
        mine = [two for two in zip(cases, answers, strict=True) if two[0].source == source]
        todo = [one for case, answer in mine if (one := asked(case, answer.diagnosis))]
        folder = options.out / "experiments" / engine.replace(":", ".") / source.replace(" ", "-")
        done = do_experiments(todo, folder, options.jobs)
        new = [case for _, case in done if case is not None]
        judged = iter(judge_all(new, ask(engine, new, options)))
        for one, case in done:
            its = None if case is None else next(judged)
            found.append(tried(one, case, folder / "plans", its))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Take the command line."""
    options = _options(arguments)
    try:
        cases = gather(options)
        if not cases:
            print("there is no record to diagnose; give --own, --plant, --folder or --cases")
            return 2
        names: list[str] = options.engine or [engines.INSTALLED]
        for name in names:
            engines.load(name)
        answers = {name: ask(name, cases, options) for name in names}
        judged = {name: judge_all(cases, its) for name, its in answers.items()}
        against = None if options.against is None else _read(options.against)
    except (TruthError, engines.EngineError) as error:
        print(f"benchmarks.blind: {error}", file=sys.stderr)
        return 2
    document: dict[str, Any] = {
        "circumstances": circumstances(" ".join(sys.argv), 1, quick=False),
        "records": len(cases),
        "engines": {name: engine_document(its) for name, its in judged.items()},
        "paired": [],
    }
    texts = [engine_text(name, its) for name, its in judged.items()]
    mine = {name: rows(its) for name, its in judged.items()}
    first = names[0]
    others = {name: mine[name] for name in names[1:]}
    if against is not None:
        others |= {f"{name} of {options.against}": its for name, its in against.items()}
    for name, its in others.items():
        paired = compare(mine[first], its)
        texts.append(paired_text(first, name, paired))
        lines = [one.line() for one in paired]
        document["paired"].append({"first": first, "second": name, "outcomes": lines})
    if options.experiments:
        done = try_experiments(first, cases, answers[first], options)
        texts.append(figures_text(f"Experiments that {first} recommends", resolving(done)))
        document["experiments"] = [one.line() for one in done]
    file: Path = options.json or options.out / "result.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    text = "\n".join(texts)
    file.with_suffix(".md").write_text(f"# Blind check\n\n{text}", encoding="utf-8")
    print(text)
    print(f"written: {file} and {file.with_suffix('.md')}")
    return _reached(judged[first], options.least)


def _reached(judged: Sequence[Judged], least: float | None) -> int:
    """Give the exit code: 1 where fewer records than asked for are right."""
    share = sum(one.right for one in judged) / len(judged)
    if least is None or share >= least:
        return 0
    print(f"right: {share:.3f} of the records, less than --least {least:g}", file=sys.stderr)
    return 1


def _read(file: Path) -> dict[str, list[dict[str, Any]]]:
    """Read the rows of an earlier result."""
    try:
        told = json.loads(file.read_text(encoding="utf-8"))["engines"]
        return {name: its["records"] for name, its in told.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TruthError(f"--against {file}: it is no result of this command: {error}") from error


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind",
        description="Diagnose fresh records whose truth is known, and score the answers.",
    )
    make = parser.add_argument_group("records")
    make.add_argument("--own", type=int, nargs="*", metavar="SEED", help="own generator, by seeds")
    make.add_argument(
        "--fodo", type=int, nargs="*", metavar="SEED", help=f"small ring, by seeds [{FODO} records]"
    )
    make.add_argument(
        "--many", type=int, nargs="*", metavar="SEED", help="small rings of many kinds, by seeds"
    )
    make.add_argument(
        "--suite",
        choices=get_args(Suite),
        default="fast",
        help="of the own; healthy: of --many too, only records without a gap [fast]",
    )
    make.add_argument("--plant", type=Path, metavar="PATH", help="an external generator: a package")
    make.add_argument("--seed", type=int, default=1, help="of --plant [1]")
    make.add_argument("--first", type=int, metavar="N", help="of every generator, at random [all]")
    make.add_argument(
        "--folder", type=Path, nargs="*", help="DIR of NAME.npz, truths in DIR_truth/NAME.*json"
    )
    make.add_argument("--cases", type=Path, nargs="*", help="lists (TOML) of records of one truth")
    make.add_argument("--names", type=Path, help="table (TOML) of an external generator's words")
    ask = parser.add_argument_group("engines")
    ask.add_argument(
        "--engine",
        action="append",
        metavar="MODULE:FUNCTION",
        help=f"repeatable; the first one is held against the others [{engines.INSTALLED}]",
    )
    ask.add_argument("--against", type=Path, metavar="JSON", help="an earlier result, paired")
    ask.add_argument("--no-later", action="store_true", help="give no later record")
    ask.add_argument(
        "--leave-out", action="store_true", help="ask once more with the true effect left out"
    )
    ask.add_argument(
        "--experiments", action="store_true", help="do what ambiguous answers recommend (own only)"
    )
    ask.add_argument("--jobs", type=int, default=2, help="records at the same time [2]")
    ask.add_argument(
        "--longest", type=float, default=LONGEST, help="processor time for a record [s] [600]"
    )
    told = parser.add_argument_group("results")
    told.add_argument("--out", type=Path, default=Path("orbitfb-data/blind"), help="kept work")
    told.add_argument("--json", type=Path, help="result; a table .md beside it [OUT/result.json]")
    told.add_argument("--least", type=float, help="share that must be right, else exit code 1")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
