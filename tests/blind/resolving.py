"""What became of the experiments that ambiguous answers asked for."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.blind.figures import Figure, rate
from tests.blind.judging import Judged, Order, judge
from tests.blind.truth import read_truth

NAMED = ("named", "named_plus_remainder")
RECOGNISED = ("unknown", "named_plus_remainder")


@dataclass
class Tried:
    """An ambiguous answer, and the answer to the record of its experiment.

    Args:
        truth: Of the case.
        kind: Of experiment.
        splits: Effects to be told apart.
        outcome: `done`; `no excitation`, if it moves no corrector; `no plan`, if the answer asked
            for a movement and planning it failed; `not done`, if the generator could not.
        judged: The new answer; None where there is none to judge.
        ticks: Of the new record.
        planned_ticks: That it was to have; more than `ticks` where the case has no room for them
            or an interlock stopped it.
    """

    truth: dict[str, Any]
    kind: str
    splits: tuple[str, ...]
    outcome: str
    judged: Judged | None = None
    ticks: int = 0
    planned_ticks: int = 0

    @property
    def known(self) -> bool:
        """Whether there is a name to be found."""
        effects = self.truth["effects"]
        return bool(effects) and all(effect["known"] for effect in effects)

    @property
    def resolved(self) -> bool:
        """Whether the new answer is sure and right: the very effect, none of its class.

        Without an effect that has a name the right answer is that there is none.
        """
        if self.judged is None:
            return False
        if self.known:
            return self.judged.state in NAMED and self.judged.exact
        return self.judged.state in (RECOGNISED if self.truth["effects"] else ("no_gap",))

    def line(self) -> dict[str, Any]:
        """Tell it as the results have it."""
        its = self.judged
        return {
            "case": self.truth["case"],
            "true": " + ".join(e["effect"] for e in self.truth["effects"]) or "no gap",
            "splits": list(self.splits),
            "kind": self.kind,
            "outcome": self.outcome,
            "ticks": self.ticks,
            "planned_ticks": self.planned_ticks,
            "state": None if its is None else its.state,
            "named": [] if its is None else its.effects,
            "resolved": self.resolved,
        }


def read_tried(
    folder: Path, truths: Sequence[dict[str, Any]], orders: dict[str, Order]
) -> list[Tried]:
    """Read what became of all experiments.

    Args:
        folder: With `plans`, `truth` and `answers`.
        truths: Of the suite.
        orders: By ring.
    """
    new: dict[str, dict[str, Any]] = {}
    if (folder / "truth" / "manifest.json").exists():
        new = {truth["case"]: truth for truth in read_truth(folder / "truth")[0]}
    found: list[Tried] = []
    for truth in truths:
        file = folder / "plans" / f"{truth['case']}.json"
        if not file.exists():
            continue
        told = json.loads(file.read_text(encoding="utf-8"))
        one = Tried(truth, told["kind"], tuple(told["splits"]), "no excitation")
        found.append(one)
        if told["exit"] or (told["moves"] and truth["case"] not in new):
            one.outcome = "no plan" if told["exit"] else "not done"
        elif told["moves"]:
            its = new[truth["case"]]
            one.outcome = "done"
            one.ticks, one.planned_ticks = its["ticks"], its["planned_ticks"]
            one.judged = judge(its, folder / "answers" / truth["case"], orders)
    return found


def resolving(tried: Sequence[Tried]) -> list[Figure]:
    """Give the figures of experiments. One that could not be planned did not resolve."""
    moved = [one for one in tried if one.outcome in ("done", "no plan")]
    return [
        rate(
            "recommended experiment resolves an ambiguous case",
            (one.resolved for one in moved if one.known),
            "≥ 0.80",
        ),
        rate(
            "experiment shows that a name was none (no gap, invented)",
            (one.resolved for one in moved if not one.known),
        ),
        rate(
            "ambiguous, and no excitation is recommended (not tried)",
            (one.outcome == "no excitation" for one in tried),
        ),
    ]


def experiments_table(tried: Sequence[Tried]) -> str:
    """Write what was tried for people."""
    if not tried:
        return ""
    apart = Counter(one.kind for one in tried if one.outcome == "no excitation")
    kinds = ", ".join(f"{kind} {count}" for kind, count in apart.most_common()) or "none"
    short = sum(0 < one.ticks < one.planned_ticks for one in tried)
    lines = [
        "",
        "## Recommended experiments",
        "",
        "The same machine once more, with the planned excitation and new noise; the new record "
        "alone is diagnosed. Resolved: `named` or `named_plus_remainder`, and the very effect, "
        "none of its class. A plan that failed did not resolve; what the generator could not do "
        "is left out. Answers that recommend something else than an excitation are not tried: "
        f"{kinds}. Cut short by the length of the case or an interlock: {short}.",
        "",
        "| true | to be told apart | experiment | ticks | answer | resolved |",
        "|---|---|---|---|---|---|",
    ]
    for one in tried:
        line = one.line()
        answer = one.outcome
        if one.judged is not None:
            answer = (
                f"{line['state']}: {', '.join(line['named'])}" if line["named"] else line["state"]
            )
        yes = "–" if one.outcome == "no excitation" else ("yes" if one.resolved else "no")
        lines.append(
            f"| {line['true']} | {', '.join(one.splits)} | {one.kind} | {one.ticks or '–'} | "
            f"{answer} | {yes} |"
        )
    return "\n".join(lines) + "\n"
