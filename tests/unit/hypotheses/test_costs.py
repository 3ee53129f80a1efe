"""What the values of a law cost, and the sizes of a set."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.many import write
from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.ranking import cost_of
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.registry import effect
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.priors import VALUE_COST
from orbitfb.records.reading.load import load
from tests.unit.hypotheses.small_records import make_record


@pytest.mark.parametrize(
    ("kind", "values", "count"),
    [
        ("corrector-deadband", {"width": 1e-3}, 1),
        ("corrector-stuck", {}, 0),
        ("corrector-stuck", {"left": 1.0, "decay": 1e-9}, 0),
        ("corrector-stuck", {"left": 0.0}, 1),
        ("corrector-stuck", {"left": 0.0, "decay": 0.5}, 2),
    ],
)
def test_an_optional_value_costs_where_it_is_used(
    kind: str, values: dict[str, float], count: int
) -> None:
    """A dead-band wider than all motion does what a frozen current does, and must not win."""
    scorer = Scorer.of(Workspace.of(make_record(72), [effect("corrector-gain")]))
    assert cost_of(effect(kind), values, scorer) == count * VALUE_COST


def test_a_needle_pays_for_all_that_it_was_found_among() -> None:
    """A step is told from another where their errors of rounding no longer agree."""
    record = make_record(72)
    kind, step = effect("corrector-quantisation"), 1e-3
    scorer = Scorer.of(Workspace.of(record, [effect("corrector-gain")]))
    told_apart = kind.told_apart({"step": step}, record)
    assert cost_of(kind, {"step": step}, scorer) == VALUE_COST + np.log(told_apart)

    def rounding(frequency: float) -> Vector:
        turns = frequency * record.setpoints
        return ((np.round(turns) - turns) / frequency).ravel()

    def alike(apart: float) -> float:
        beside = 1.0 / step * (1.0 + apart / told_apart)
        return float(np.corrcoef(rounding(1.0 / step), rounding(beside))[0, 1])

    assert alike(0.2) > 0.8 and 0.2 < alike(1.0) < 0.7 and abs(alike(5.0)) < 0.1


def test_of_no_gap_no_needle_stands_out(tmp_path: Path) -> None:
    """A step for each of two correctors had 12 nats here, for which nobody had paid."""
    name = write("flicker", "healthy", 101, tmp_path / "records")
    record = load(tmp_path / "records" / f"{name}.npz", planes=None, ring=None).record
    kind = effect("corrector-quantisation")
    space = Workspace.of(record, [kind, effect("corrector-gain"), effect("bpm-gain")])
    assert max((one.evidence for one in candidates_of(space, [kind])), default=0.0) < 5.0


def test_no_set_is_worth_more_than_what_it_does_is_likely(tmp_path: Path) -> None:
    """Sets are found with information by band, which is right to a per cent of much evidence."""
    name = write("few-correctors", "lag", 31, tmp_path / "records")
    record = load(tmp_path / "records" / f"{name}.npz", planes=None, ring=None).record
    kinds = [effect(one) for one in ("corrector-lag", "corrector-slew")]
    space = Workspace.of(record, [*kinds, effect("corrector-gain")])
    scorer = Scorer.of(space)
    found = [one for one in candidates_of(space, kinds) if one.additive and one.cost is not None]
    assert any(len(one.places) > 1 for one in found)
    for one in found:
        assert scorer.likelihood(np.asarray(one.field)) > one.evidence, one.describe()


def test_what_sizes_cost_is_their_share_of_the_priors() -> None:
    """One size of information H and variance s²: ½ ln(1 + Hs²) + ½ (size/s)²."""
    terms = NormalTerms(np.array([30.0]), np.array([[8.0]]), np.array([4.0]))
    size = terms.mean()
    likelihood = float(30.0 * size[0] - 4.0 * size[0] ** 2)
    assert terms.cost(size) == pytest.approx(0.5 * np.log(33.0) + 0.125 * float(size[0]) ** 2)
    assert likelihood - terms.cost(size) == pytest.approx(terms.evidence())
