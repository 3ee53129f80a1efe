"""The command that checks the diagnosis on sealed cases: generate, diagnose, score.

Three kinds of processes that share nothing but files: a generator that knows no effect of the
library, `orbitfb diagnose` once per record, and a scorer that alone opens the truth.
"""

from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.blind_processes import outliving_none


@outliving_none()
def diagnose_blind(
    suite: Annotated[
        str,
        typer.Option(help="quick: about 50 cases, fast: 230, full: 1700."),
    ] = "quick",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the cases.")] = 1,
    first: Annotated[
        int | None,
        typer.Option(min=1, help="Only so many cases of the suite, drawn at random [all]."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Diagnoses at the same time.")] = 2,
    out: Annotated[
        Path, typer.Option(help="Directory for records, truth, answers and the table.")
    ] = Path("orbitfb-data/blind"),
    leave_one_out: Annotated[
        bool,
        typer.Option(help="Diagnose clear cases once more with their effect left out."),
    ] = True,
    experiments: Annotated[
        bool,
        typer.Option(help="Do the experiments that ambiguous answers ask for, and diagnose them."),
    ] = True,
    baselines: Annotated[bool, typer.Option(help="Score simpler methods beside it.")] = True,
) -> None:
    """Check the diagnosis on sealed cases; what is answered already is not done again."""
    from orbitfb.cli.blind_experiments import do_experiments
    from orbitfb.cli.blind_processes import claim, diagnose_all, module, source_checkout, tasks
    from orbitfb.cli.options import make_out
    from orbitfb.core.errors import ConfigError

    source = source_checkout()
    if suite not in ("quick", "fast", "full"):
        raise ConfigError(f"--suite: there is no {suite!r}; choose quick, fast or full")
    make_out(out)
    claim(out, suite, seed)
    data, truth, answers = out / "data", out / "truth", out / "answers"
    module(
        source,
        "tests.blind.generate",
        *("--suite", suite, "--seed", str(seed), "--jobs", str(jobs)),
        *("--out", str(data), "--truth", str(truth)),
        *(() if first is None else ("--first", str(first))),
    )
    diagnose_all(list(tasks(data, answers)), jobs, "diagnosed")
    arguments = ["--truth", str(truth), "--answers", str(answers), "--rings", str(data)]
    if leave_one_out:
        chosen = module(source, "tests.blind.leave_out", "--truth", str(truth), quiet=True)
        without = dict(line.split() for line in chosen.splitlines())
        todo = list(tasks(data, out / "without", without))
        diagnose_all(todo, jobs, "diagnosed without their effect")
        arguments += ["--without", str(out / "without")]
    if experiments:
        do_experiments(source, data, truth, answers, out / "experiments", jobs)
        arguments += ["--experiments", str(out / "experiments")]
    if baselines:
        given = ("--data", str(data), "--out", str(out / "baselines"), "--jobs", str(jobs))
        for name in module(source, "tests.blind.baselines", *given, quiet=True).split():
            arguments += ["--baseline", f"{name}={out / 'baselines' / name}"]
    arguments += ["--out", str(out / "result.json")]
    print(module(source, "tests.blind.score", *arguments, quiet=True), end="")
    print(f"written: {out / 'result.json'} and {out / 'result.md'}")
