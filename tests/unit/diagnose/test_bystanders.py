"""Groups of which not all members are struck."""

import pytest
from test_scans import CORRECTORS, record_with

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.registry import all_effects

CELL = [name for name in CORRECTORS if name.endswith("C09")]


@pytest.mark.parametrize("spared", [[], CELL[3:4], CELL[1:3]])
def test_a_crate_need_not_end_where_its_cell_does(spared):
    struck = [name for name in CELL if name not in spared]
    effect = f"corrector-lag:tau=0.1s,names={'+'.join(struck)}"
    bench = Bench(record_with(effect, dither=2e-3))
    found, *_ = tournament(bench, [all_effects()["corrector-lag"]])
    assert [CORRECTORS[place] for place in found.cause.places] == struck
    without = f" without {', '.join(spared)}" if spared else ""
    assert found.candidate.group == f"C09{without}"
    low, high = found.fit.interval(0)
    assert low < 0.1 < high
