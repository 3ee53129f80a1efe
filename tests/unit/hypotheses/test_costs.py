"""What the values of a law cost."""

import pytest

from orbitfb.diagnose.hypotheses.ranking import cost_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.registry import effect
from orbitfb.estimation.priors import VALUE_COST
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
